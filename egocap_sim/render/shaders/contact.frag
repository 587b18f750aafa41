#version 330 core
#extension GL_ARB_shading_language_420pack : require
// A factor of what is drawn already.
layout(binding = 0) uniform sampler2DArray left_over;
in vec3 at;
out vec4 color;
void main() {
  color = vec4(texture(left_over, at).rrr, 1.0);
}

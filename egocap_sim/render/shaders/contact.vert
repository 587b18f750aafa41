#version 330 core
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 place;  // in the texture, and its layer
uniform mat4 clip_from_world;
out vec3 at;
void main() {
  gl_Position = clip_from_world * vec4(position, 1.0);
  at = place;
}

#version 330 core
layout(location = 0) in vec3 position;
layout(location = TEXCOORD_1_LOC) in vec2 layer_part;
uniform mat4 clip_from_world;
flat out float part;
void main() {
  gl_Position = clip_from_world * vec4(position, 1.0);
  part = layer_part.y;
}

#version 330 core
// Vertices arrive posed, in world coordinates: skinning is done once on the processor, not once a face.
layout(location = 0) in vec3 position;
layout(location = NORMAL_LOC) in vec3 normal;
layout(location = TEXCOORD_0_LOC) in vec2 texcoord;
layout(location = TEXCOORD_1_LOC) in vec2 layer_part;
uniform mat4 clip_from_world;
uniform mat4 shadow_from_world;  // to texture coordinates and depth of the shadow map, 0..1
out vec3 world_normal;
out vec3 world_position;
out vec3 shadow_position;
out vec2 uv;
flat out vec2 layer_and_part;
void main() {
  gl_Position = clip_from_world * vec4(position, 1.0);
  world_normal = normal;
  world_position = position;
  // Looked up a little off the surface, or a slanted surface shades itself in stripes.
  shadow_position = (shadow_from_world * vec4(position + 0.012 * normal, 1.0)).xyz;
  uv = texcoord;
  layer_and_part = layer_part;
}

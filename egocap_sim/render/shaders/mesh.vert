#version 330 core
// Vertices arrive posed, in world coordinates: skinning is done once on the processor, not once a
// face. Light is worked out here, not at every pixel: people are finely meshed and rooms are flat.
// Light adds up in linear units; colours are sRGB, whose curve is taken to be a square root.
layout(location = 0) in vec3 position;
layout(location = NORMAL_LOC) in vec3 normal;
layout(location = TEXCOORD_0_LOC) in vec2 texcoord;
layout(location = TEXCOORD_1_LOC) in vec2 layer_part;
uniform mat4 clip_from_world;
uniform mat4 shadow_from_world;  // to texture coordinates and depth of the shadow map, 0..1
uniform vec3 eye;
uniform vec3 to_light;
uniform vec3 light_color;
uniform vec3 sky_color;          // ambient light on surfaces that face sky_axis
uniform vec3 ground_color;       // and on those that face away
uniform vec3 sky_axis;
out vec3 shadow_position;
out vec3 shaded;                 // factor of the texture's colour out of the main light
out vec4 lit;                    // what the main light adds to it; w: highlight
out vec2 uv;
flat out vec2 layer_and_part;
void main() {
  gl_Position = clip_from_world * vec4(position, 1.0);
  // Looked up a little off the surface, or a slanted surface shades itself in stripes.
  shadow_position = (shadow_from_world * vec4(position + 0.012 * normal, 1.0)).xyz;
  float facing = max(dot(normal, to_light), 0.0);
  vec3 ambient = mix(ground_color, sky_color, 0.5 + 0.5 * dot(normal, sky_axis));
  shaded = sqrt(ambient);
  lit.rgb = sqrt(ambient + facing * light_color) - shaded;
  vec3 h = normalize(to_light + normalize(eye - position));
  lit.w = 0.6 * pow(max(dot(normal, h), 0.0), 12.0);
  uv = texcoord;
  layer_and_part = layer_part;
}

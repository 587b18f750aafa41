#version 330 core
#extension GL_ARB_shading_language_420pack : require
// Light adds up in (nearly) linear units: colours are squared on the way in and rooted on the way
// out, which is sRGB's curve to a few percent and far cheaper. Alpha carries the part label.
layout(binding = 0) uniform sampler2DArray textures;  // alpha: 0..0.8 strength of the highlight, 1 glows by itself
layout(binding = 1) uniform sampler2DShadow shadow_map;
uniform vec3 eye;
uniform vec3 to_light;
uniform vec3 light_color;
uniform vec3 sky_color;                // ambient light from above and from the window side
uniform vec3 ground_color;             // and from below
uniform vec3 sky_axis;
in vec3 world_normal;
in vec3 world_position;
in vec3 shadow_position;
in vec2 uv;
flat in vec2 layer_and_part;
out vec4 color;
void main() {
  vec4 texel = texture(textures, vec3(uv, layer_and_part.x));
  vec3 albedo = texel.rgb * texel.rgb;
  vec3 n = normalize(gl_FrontFacing ? world_normal : -world_normal);
  float facing = max(dot(n, to_light), 0.0);
  float lit = texture(shadow_map, shadow_position);
  vec3 ambient = mix(ground_color, sky_color, 0.5 + 0.5 * dot(n, sky_axis));
  vec3 h = normalize(to_light + normalize(eye - world_position));
  float s = max(dot(n, h), 0.0);
  s *= s; s *= s; s *= s; s *= s;
  vec3 light = ambient + (lit * facing) * light_color;
  vec3 linear = albedo * light + (texel.a * s * lit * 0.35) * light_color;
  if (texel.a > 0.9) linear = albedo;
  color = vec4(sqrt(linear), layer_and_part.y);
}

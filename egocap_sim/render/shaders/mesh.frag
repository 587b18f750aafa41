#version 330 core
#extension GL_ARB_shading_language_420pack : require
// Kept short: on the software renderer nearly all the time goes here. Alpha carries the part label.
layout(binding = 0) uniform sampler2DArray textures;  // alpha: 0..0.8 highlight, 1 shines by itself
#ifdef SOFT_SHADOWS
layout(binding = 1) uniform sampler2D shadow_map;  // mean depth, mean of its square
#else
layout(binding = 1) uniform sampler2DShadow shadow_map;
#endif
in vec3 shadow_position;
in vec3 shaded;
in vec4 lit;
in vec2 uv;
flat in vec2 layer_and_part;
out vec4 color;
float sunlit() {
#ifdef SOFT_SHADOWS
  vec2 depth = texture(shadow_map, shadow_position.xy).rg;
  float behind = max(shadow_position.z - depth.x, 0.0);
  float variance = max(depth.y - depth.x * depth.x, 1e-7);
  // What shines through from between two casters is cut off.
  return max(1.18 * variance / (variance + behind * behind) - 0.18, 0.0);
#else
  return texture(shadow_map, shadow_position);
#endif
}
void main() {
  vec4 texel = texture(textures, vec3(uv, layer_and_part.x));
  vec4 light = sunlit() * lit;
  vec3 surface = texel.rgb * (shaded + light.rgb) + texel.a * light.w;
  surface *= 0.72 + surface * (0.84 - 0.56 * surface);  // a camera's tone curve: deeper, crisper
  color = vec4(texel.a > 0.9 ? texel.rgb : surface, layer_and_part.y);
}

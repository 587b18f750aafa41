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
uniform vec3 room;               // half its length and width, and height; 1000 where there is none
out vec3 shadow_position;
out vec3 shaded;                 // factor of the texture's colour out of the main light
out vec4 lit;                    // what the main light adds to it; w: highlight
out vec2 uv;
flat out vec2 layer_and_part;
// Share of the ambient light that two walls or wall and floor leave each other, by the distance from
// the other one; a surface does not shade itself.
float corner(float distance, float along) {
  float near = clamp(1.0 - 0.9 * distance, 0.0, 1.0);
  return 1.0 - 0.42 * near * near * (1.0 - along * along);
}
void main() {
  gl_Position = clip_from_world * vec4(position, 1.0);
  // Looked up a little off the surface, or a slanted surface shades itself in stripes.
  shadow_position = (shadow_from_world * vec4(position + 0.012 * normal, 1.0)).xyz;
  float facing = max(dot(normal, to_light), 0.0);
  vec3 ambient = mix(ground_color, sky_color, 0.5 + 0.5 * dot(normal, sky_axis));
  // The layer's fraction tells what kind of surface it is: 0 a thing, 0.15 cloth, 0.3 skin.
  float kind = fract(layer_part.x);
  float skin = step(0.22, kind), cloth = step(0.07, kind) - skin;
  vec3 view = normalize(eye - position);
  float rim = 1.0 - max(dot(normal, view), 0.0);
  rim *= rim * rim;
  if (room.x < 999.0)
    ambient *= corner(room.x - abs(position.x), normal.x) * corner(room.y - abs(position.y), normal.y)
        * corner(room.z - position.z, normal.z) * corner(position.z, normal.z);
  else  // outdoors houses are coarse: only people are shaded towards the ground
    ambient *= mix(1.0, corner(position.z, normal.z), skin + cloth);
  ambient *= 1.0 + 0.45 * cloth * rim;  // fuzz catches light from behind
  // Light that has gone through skin comes out reddish beyond where the light itself ends.
  vec3 through = vec3(0.40, 0.16, 0.09) * skin;
  float lambert = dot(normal, to_light);
  vec3 bled = max((lambert + through) / (1.0 + through), 0.0) - facing;
  ambient += 0.6 * bled * light_color;
  shaded = sqrt(ambient);
  lit.rgb = sqrt(ambient + facing * light_color) - shaded;
  vec3 h = normalize(to_light + view);
  float spot = max(dot(normal, h), 0.0);
  spot *= spot;
  spot *= spot;
  float broad = spot * spot * spot;
  lit.w = mix(0.6 * broad, (0.35 + 2.0 * rim) * broad * broad, skin);  // skin: small, oily, grazing
  uv = texcoord;
  layer_and_part = layer_part;
}

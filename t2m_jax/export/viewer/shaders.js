// GLSL for WebGL 2. Light is computed in linear light and shown as sRGB.

const CAPSULE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 surface;  // angle around the axis, place between seam and pole 0..1, which end
layout(location = 1) in vec4 startBall;
layout(location = 2) in vec4 endBall;
layout(location = 3) in vec3 tint;
uniform mat4 matrix;
out vec3 world;
out vec3 normal;
out vec3 colour;
void main() {
  vec3 axis = endBall.xyz - startBall.xyz;
  float span = length(axis);
  vec3 along = span > 1e-6 ? axis / span : vec3(0.0, 1.0, 0.0);
  vec3 side = normalize(cross(along, abs(along.y) < 0.9 ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0)));
  vec3 other = cross(along, side);
  // Both balls meet the cone between them on the circle at this latitude.
  float seam = asin(clamp((startBall.w - endBall.w) / max(span, 1e-6), -0.98, 0.98));
  float pole = surface.z > 0.5 ? 1.5707963 : -1.5707963;
  float latitude = mix(seam, pole, surface.y);
  normal = along * sin(latitude) + (side * cos(surface.x) + other * sin(surface.x)) * cos(latitude);
  vec4 ball = surface.z > 0.5 ? endBall : startBall;
  world = ball.xyz + ball.w * normal;
  colour = tint;
  gl_Position = matrix * vec4(world, 1.0);
}`;

const SHADOW_FRAGMENT = `#version 300 es
precision mediump float;
void main() {}`;

const LIGHT = `
uniform mat4 lightMatrix;
uniform vec3 lightDirection;
uniform highp sampler2DShadow shadowMap;
// The fraction of key light that arrives, from samples on a disc in the shadow map. Its radius is in texels.
float lit(vec3 place, float texels, float bias) {
  vec3 spot = (lightMatrix * vec4(place, 1.0)).xyz * 0.5 + 0.5;
  if (any(lessThan(spot.xy, vec2(0.0))) || any(greaterThan(spot.xy, vec2(1.0)))) return 1.0;
  float sum = 0.0;
  for (int i = 0; i < TAPS; i++) {
    float turn = 2.3999632 * float(i);
    vec2 tap = sqrt((float(i) + 0.5) / float(TAPS)) * vec2(cos(turn), sin(turn));
    sum += texture(shadowMap, vec3(spot.xy + tap * texels / SHADOW_SIZE, spot.z - bias));
  }
  return sum / float(TAPS);
}
vec3 display(vec3 light) { return pow(clamp(light, 0.0, 1.0), vec3(1.0 / 2.2)); }
`;

const BODY_FRAGMENT = `#version 300 es
precision highp float;
#define TAPS 8
${LIGHT}
uniform vec3 eye;
uniform vec3 skyLight;
uniform vec3 groundLight;
uniform float keyLight;
uniform float fillLight;
in vec3 world;
in vec3 normal;
in vec3 colour;
out vec4 fragment;
void main() {
  vec3 n = normalize(normal);
  vec3 toEye = normalize(eye - world);
  float facing = dot(n, lightDirection);
  float key = max(facing, 0.0) * lit(world + 0.014 * n, 7.0, 0.0008);
  float soft = 0.5 + 0.5 * n.y;
  // Surfaces that are near the ground and face down get less light from the sky.
  float open = mix(1.0, smoothstep(0.0, 0.45, world.y + 0.25 * n.y), 0.45);
  vec3 ambient = mix(groundLight, skyLight, soft) * open;
  ambient += fillLight * max(dot(n, FILL_DIRECTION), 0.0);
  float fresnel = pow(1.0 - max(dot(n, toEye), 0.0), 4.0);
  float shine = pow(max(dot(n, normalize(lightDirection + toEye)), 0.0), 38.0) * 0.13 * step(0.0, facing);
  vec3 light = colour * (ambient + keyLight * key * vec3(1.0, 0.965, 0.91));
  light += shine * key + fresnel * (0.10 * skyLight + 0.05) * soft;
  fragment = vec4(display(light), 1.0);
}`;

const GROUND_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec2 corner;
uniform mat4 matrix;
uniform vec2 centre;
out vec3 world;
void main() {
  world = vec3(centre.x + corner.x * 40.0, 0.0, centre.y + corner.y * 40.0);
  gl_Position = matrix * vec4(world, 1.0);
}`;

const GROUND_FRAGMENT = `#version 300 es
precision highp float;
#define TAPS 24
${LIGHT}
uniform vec2 centre;
uniform float reach;
uniform vec3 ground;
uniform vec3 lines;
uniform float shadowStrength;
in vec3 world;
out vec4 fragment;
float grid(float spacing, float thickness) {
  vec2 place = world.xz / spacing;
  vec2 width = fwidth(place);
  vec2 off = abs(fract(place - 0.5) - 0.5);
  vec2 drawn = vec2(thickness / spacing);
  vec2 line = (1.0 - smoothstep(drawn, drawn + 1.2 * width, off)) * clamp(1.0 - 2.2 * width, 0.0, 1.0);
  return max(line.x, line.y);
}
void main() {
  float fade = 1.0 - smoothstep(0.25, 1.0, length(world.xz - centre) / reach);
  float shade = (1.0 - lit(world, SOFTNESS, 0.0004)) * shadowStrength;
  vec3 surface = mix(ground, lines, max(0.55 * grid(0.5, 0.002), grid(1.0, 0.004)));
  surface *= 1.0 - shade;
  fragment = vec4(surface * fade, fade);
}`;

const TRAIL_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 spot;  // x, z, seconds
uniform mat4 matrix;
out float moment;
void main() {
  moment = spot.z;
  gl_Position = matrix * vec4(spot.x, 0.004, spot.y, 1.0);
}`;

const TRAIL_FRAGMENT = `#version 300 es
precision highp float;
uniform float now;
uniform vec3 accent;
in float moment;
out vec4 fragment;
void main() {
  float age = now - moment;
  float strength = age < 0.0 ? 0.13 : mix(0.75, 0.28, smoothstep(0.0, 4.0, age));
  fragment = vec4(accent * strength, strength);
}`;

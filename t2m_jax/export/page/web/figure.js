// The figure of a motion, as t2m_jax/export/render makes it: points around the joints, and where feet stand. figure.json has
// the weights, the parts and the sizes.

import { add, cross, dot, length, subtract, unit } from "./vectors.js";

function median(values) {
  const sorted = values.toSorted((a, b) => a - b);
  return (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;
}

// Returns numbers as frames of points.
export function framesOf(numbers, joints) {
  const point = (frame, joint) => [...numbers.subarray(3 * (frame * joints + joint), 3 * (frame * joints + joint) + 3)];
  return Array.from({ length: numbers.length / joints / 3 }, (_, frame) => Array.from({ length: joints }, (_, joint) => point(frame, joint)));
}

// Returns how long the legs are, relative to the figure whose radii the parts have.
function scaleOf(frames, { roles, sizes }) {
  const ofLeg = (frame, [hip, knee, ankle]) => length(subtract(frame[knee], frame[hip])) + length(subtract(frame[ankle], frame[knee]));
  const legs = frames.map((frame) => ofLeg(frame, roles.legs[0]) + ofLeg(frame, roles.legs[1]));
  return Math.max(median(legs) / 2, 1e-3) / sizes.leg;
}

// Returns the two ends of the face plate, which shows where the head looks.
function facePoints(points, { head, roles }, scale) {
  const across = unit(subtract(points[roles.leftShoulder], points[roles.rightShoulder]));
  const up = unit(subtract(points[head], points[roles.neck]));
  const tip = subtract(points[roles.tip], points[roles.neck]);
  const lean = add(tip, up, -dot(tip, up));
  const forward = unit(add(unit(cross(across, up)), lean, 1 / Math.max(length(tip), 1e-6)));
  const side = cross(up, forward);
  return [0.034, -0.034].map((aside) => {
    const eye = [0, 1, 2].map((axis) => 0.066 * forward[axis] + aside * side[axis] + 0.012 * up[axis]);
    return add(points[head], eye, scale);
  });
}

// Returns when and where the toes of a foot are low and still: [first frame, last frame, x, z].
function contactsOf(path, fps, scale, { contact }) {
  const [height, fast, shortest] = contact;
  const at = (frame) => path[Math.min(Math.max(frame, 0), path.length - 1)];
  const speed = (frame) => {
    const steps = Math.min(frame + 1, path.length - 1) - Math.max(frame - 1, 0);
    return steps ? (length(subtract(at(frame + 1), at(frame - 1))) / steps) * fps : 0;
  };
  const stands = path.map((point, frame) => point[1] < height * scale && speed(frame) < fast * scale);
  const found = [];
  for (let first = 0; first < path.length; first += 1) {
    if (!stands[first]) continue;
    let end = first;
    while (stands[end]) end += 1;
    const mean = (axis) => path.slice(first, end).reduce((sum, point) => sum + point[axis], 0) / (end - first);
    if (end - first >= shortest * fps) found.push([first, end - 1, mean(0), mean(2)]);
    first = end;
  }
  return found;
}

// Returns what the stage shows of joint positions, with its floor at y = 0. `sentences` are [first frame, text], if several.
export function makeFigure(positions, { figure, motion, caption, sentences = [] }) {
  const { sizes, roles, weights } = figure;
  let frames = framesOf(positions, motion.joints.length);
  if (figure.mirrored) frames = frames.map((frame) => frame.map(([x, y, z]) => [-x, y, z]));
  let scale = scaleOf(frames, figure);
  if (scale < sizes.human[0] || scale > sizes.human[1]) {
    frames = frames.map((frame) => frame.map((point) => point.map((value) => value / scale)));
    scale = 1;
  }
  const lowest = Math.min(...frames.flat().map((point) => point[1]));
  const lift = sizes.sole * scale - (Math.abs(lowest) > sizes.floor ? lowest : 0);
  const placed = frames.map((frame) => {
    const points = weights.map((row) => row.reduce((sum, weight, joint) => (weight ? add(sum, frame[joint], weight) : sum), [0, 0, 0]));
    return [...points, ...facePoints(points, figure, scale)].map(([x, y, z]) => [x, y + lift, z]);
  });
  return {
    caption,
    sentences,
    fps: motion.fps,
    frames: placed.length,
    points: weights.length + 2,
    parts: figure.parts.map(([start, end, from, to, tint]) => [start, end, from * scale, to * scale, tint]),
    contacts: roles.feet.flatMap((foot) => contactsOf(placed.map((frame) => frame[foot]), motion.fps, scale, sizes)),
    values: Float32Array.from(placed.flat(2)),
  };
}

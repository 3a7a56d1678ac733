// The twist of upper arms and thighs about their own bone, as t2m_jax/motion/twist.py finds it: a bent elbow or knee shows
// it, and while the limb is straight it is natural and changes slowly. A twist with a weight is a vector of two numbers.

import { between, inverse, multiply, rotate } from "./rotations.js";
import { add, cross, dot, length, scaled, unit } from "./vectors.js";

const TURN = 2 * Math.PI;
export const wrapped = (angle) => angle - TURN * Math.floor((angle + Math.PI) / TURN); // between -π and π
const angleOf = ([x, y]) => Math.atan2(y, x);

// Returns rotations that bring `direction`, the bone in the rest pose, to `upper`, and the axis of its hinge to the bend.
export function limbRotations(upper, lower, { direction, axis, fps, rules }) {
  const transported = [between(direction, upper[0])]; // turn as little as possible from frame to frame
  for (let frame = 1; frame < upper.length; frame += 1) {
    transported.push(unit(multiply(between(upper[frame - 1], upper[frame]), transported[frame - 1])));
  }
  const sideways = cross(direction, axis);
  const twistOf = (vector, frame) => {
    const local = rotate(inverse(transported[frame]), vector);
    return [dot(local, axis), dot(local, sideways)];
  };
  const evidence = upper.map((bone, frame) => {
    const bend = twistOf(cross(bone, lower[frame]), frame);
    const natural = twistOf(rotate(between(direction, bone), axis), frame);
    const size = length(bend);
    const along = (1 + dot(bone, direction)) / 2; // the natural twist is unstable if the bone points the other way
    return add(scaled(bend, size / (size ** 2 + rules.trust ** 2)), natural, rules.natural * along ** 2);
  });
  const stiffness = rules.smoothness * fps ** 2;
  const path = bestPath(evidence, stiffness, { fps, ...rules });
  const differences = evidence.map((vector, frame) => wrapped(angleOf(vector) - path[frame]));
  // Evidence that contradicts the path is ignored.
  const weights = evidence.map((vector, frame) => length(vector) * Math.max(Math.cos(differences[frame]), 0) + 1e-6);
  const twists = smoothed(path.map((angle, frame) => angle + differences[frame]), weights, stiffness);
  return transported.map((turn, frame) => multiply(turn, [...scaled(direction, Math.sin(twists[frame] / 2)), Math.cos(twists[frame] / 2)]));
}

// Returns the best sequence of twists on a grid of angles (dynamic programming), without jumps by a full turn.
function bestPath(evidence, stiffness, { fps, angles: count, speed }) {
  const step = TURN / count;
  const reach = Math.min(Math.max(1, Math.floor((speed * (Math.PI / 180)) / fps / step)), count >> 1);
  const places = Array.from({ length: count }, (_, place) => place);
  const costOf = ([x, y]) => places.map((place) => -(x * Math.cos(place * step) + y * Math.sin(place * step)));
  let total = costOf(evidence[0]);
  const origins = [];
  for (const vector of evidence.slice(1)) {
    const best = places.map((place) => {
      let [lowest, origin] = [Infinity, place];
      for (let move = -reach; move <= reach; move += 1) {
        const source = (place - move + count) % count;
        const cost = total[source] + stiffness * (move * step) ** 2;
        if (cost < lowest) [lowest, origin] = [cost, source];
      }
      return [lowest, origin];
    });
    origins.push(best.map(([, origin]) => origin));
    const costs = costOf(vector);
    total = best.map(([lowest], place) => lowest + costs[place]);
  }
  const path = [total.indexOf(Math.min(...total))];
  for (const origin of origins.reverse()) path.push(origin[path.at(-1)]);
  let angle = 0;
  return path.reverse().map((place) => {
    angle += wrapped(place * step - angle);
    return angle;
  });
}

// Returns the curve that is near the values, by their weights, and whose steps are small: a system of equations with three
// diagonals, solved with Thomas' algorithm.
function smoothed(values, weights, stiffness) {
  const last = values.length - 1;
  const diagonal = weights.map((weight, frame) => weight + 2 * stiffness * (Number(frame > 0) + Number(frame < last)));
  const result = values.map((value, frame) => weights[frame] * value);
  for (let frame = 1; frame <= last; frame += 1) {
    const factor = (2 * stiffness) / diagonal[frame - 1];
    diagonal[frame] -= factor * 2 * stiffness;
    result[frame] += factor * result[frame - 1];
  }
  for (let frame = last; frame >= 0; frame -= 1) {
    result[frame] = (result[frame] + (frame < last ? 2 * stiffness * result[frame + 1] : 0)) / diagonal[frame];
  }
  return result;
}

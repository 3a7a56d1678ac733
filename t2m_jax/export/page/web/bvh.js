// BVH files as t2m_jax/motion/bvh/writer.py writes them: Y up, meters, a T-pose as rest pose.

import { childrenOf } from "./rig.js";
import { eulerOf } from "./rotations.js";
import { wrapped } from "./twist.js";
import { scaled } from "./vectors.js";

const ROTATIONS = "Zrotation Xrotation Yrotation";
const LOCKED_COSINE = 1e-4;

const numbers = (values) => values.map((value) => value.toFixed(6).replace(/^-(0\.0*)$/, "$1")).join(" ");

const depthFirst = (parents, joint = 0) => [joint, ...childrenOf(parents, joint).flatMap((child) => depthFirst(parents, child))];

function hierarchyLines(offsets, ends, parents, rig, joint = 0, pad = "") {
  const inner = `${pad}  `;
  const children = childrenOf(parents, joint).flatMap((child) => hierarchyLines(offsets, ends, parents, rig, child, inner));
  const end = children.length ? [] : [`${inner}End Site`, `${inner}{`, `${inner}  OFFSET ${numbers(ends[joint])}`, `${inner}}`];
  return [
    `${pad}${joint ? "JOINT" : "ROOT"} ${rig.names[joint]}`,
    `${pad}{`,
    `${inner}OFFSET ${numbers(offsets[joint])}`,
    `${inner}CHANNELS ${joint ? "3" : "6 Xposition Yposition Zposition"} ${ROTATIONS}`,
    ...children, ...end,
    `${pad}}`,
  ];
}

// Returns angles in radians that do not jump between frames: of the triples that give the same rotation, each frame has the
// nearest to the frame before.
function continuousEuler(turns) {
  let previous = [0, 0, 0]; // the rest pose
  return turns.map((turn) => {
    const angles = eulerOf(turn);
    const mirrored = angles.map((angle, place) => (place === 1 ? -angle : angle) + Math.PI);
    const [one, other] = [angles, mirrored].map((triple) => triple.map((angle, place) => previous[place] + wrapped(angle - previous[place])));
    const distance = (triple) => triple.reduce((sum, angle, place) => sum + Math.abs(angle - previous[place]), 0);
    const chosen = distance(other) < distance(one) ? other : one;
    if (Math.abs(Math.cos(chosen[1])) < LOCKED_COSINE) { // only a sum of the others is determined; both get half of its change
      const sign = Math.sign(Math.sin(chosen[1]));
      const change = wrapped(chosen[0] - previous[0] + sign * (chosen[2] - previous[2]));
      chosen[0] = previous[0] + change / 2;
      chosen[2] = previous[2] + (sign * change) / 2;
    }
    previous = chosen;
    return chosen;
  });
}

// Returns what says where sentences begin; braces are structure in BVH files.
function partsNote({ part_starts: starts, part_captions: captions }, fps) {
  const escaped = (text) => JSON.stringify(text).replace(/[{}\u0080-\uffff]/g, (unit) => `\\u${unit.charCodeAt(0).toString(16).padStart(4, "0")}`);
  return ` # ${starts.map((first, place) => `frame ${first} (${(first / fps).toFixed(2)} s): ${escaped(captions[place])}`).join("; ")}`;
}

// Returns the text of a BVH file of a fitted rig. If there are several sentences, the line of the first End Site tells them.
export function bvhText({ offsets, ends, roots, local }, { parents, fps }, rig, motion) {
  const angles = depthFirst(parents).map((joint) => continuousEuler(local[joint]));
  const lines = roots.map((place, frame) => numbers([...place, ...angles.flatMap((track) => scaled(track[frame], 180 / Math.PI))]));
  const joints = hierarchyLines(offsets, ends, parents, rig);
  if (motion.part_starts.length) joints[joints.findIndex((line) => line.endsWith("End Site"))] += partsNote(motion, fps);
  const head = ["HIERARCHY", ...joints, "MOTION", `Frames: ${roots.length}`, `Frame Time: ${(1 / fps).toFixed(9)}`];
  return `${[...head, ...lines].join("\n")}\n`;
}

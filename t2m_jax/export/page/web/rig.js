// A rigid figure that moves as joints do, as t2m_jax/motion/inverse_kinematics.py makes it: bones of constant length, a T-pose
// as rest pose, and a rotation per joint. figure.json says what its joints are (`rig`). Lists are by joint, then by frame.

import { bestRotation, between, IDENTITY, inverse, multiply, rotate, slerp } from "./rotations.js";
import { limbRotations } from "./twist.js";
import { add, cross, dot, length, scaled, subtract, sum, unit } from "./vectors.js";

export const childrenOf = (parents, joint) => parents.flatMap((parent, child) => (parent === joint ? [child] : []));

// Returns the rest pose: mean lengths of bones, straight limbs, and the mean shapes of pelvis and chest.
function restOffsets(paths, parents, { directions, hubs }) {
  const bones = paths.map((path, joint) => path.map((place, frame) => subtract(place, paths[Math.max(parents[joint], 0)][frame])));
  const found = directions.slice();
  for (const [hub, left, right, above] of hubs) {
    const children = childrenOf(parents, hub);
    for (const child of children) found[child] = [0, 0, 0];
    bones[above].forEach((top, frame) => {
      const across = unit(subtract(bones[left][frame], bones[right][frame]));
      const up = unit(add(top, across, -dot(top, across)));
      const axes = [across, up, cross(across, up)];
      for (const child of children) found[child] = add(found[child], axes.map((axis) => dot(axis, bones[child][frame])));
    });
  }
  return found.map((direction, joint) => scaled(unit(direction), sum(bones[joint].map(length)) / bones[joint].length));
}

// Returns paths close to the given ones in which bones and hubs are rigid: each wrong distance moves both of its joints by
// half of the error, again and again.
function rigidPaths(paths, offsets, parents, { hubs, sweeps }) {
  const pairs = parents.map((parent, child) => [child, parent]).slice(1);
  for (const [hub] of hubs) {
    const [a, b, c] = childrenOf(parents, hub);
    pairs.push([a, b], [a, c], [b, c]);
  }
  const moved = paths.map((path) => path.slice());
  for (let sweep = 0; sweep < sweeps; sweep += 1) {
    for (const [a, b] of pairs) {
      const wanted = length(parents[a] === b ? offsets[a] : subtract(offsets[a], offsets[b]));
      for (let frame = 0; frame < moved[a].length; frame += 1) {
        const apart = subtract(moved[a][frame], moved[b][frame]);
        const distance = length(apart);
        const share = (wanted - distance) / Math.max(distance, 1e-9) / 2;
        moved[a][frame] = add(moved[a][frame], apart, share);
        moved[b][frame] = add(moved[b][frame], apart, -share);
      }
    }
  }
  return moved;
}

// The joints and rotations in the world that were found so far, from the root outwards.
class Fit {
  constructor(targets, offsets, parents) {
    Object.assign(this, { targets, offsets, parents, joints: targets.slice() });
    this.turns = targets.map((path) => path.map(() => IDENTITY));
  }

  // Returns the vectors from a joint to where its only child should be.
  aim(joint) {
    const [child] = childrenOf(this.parents, joint);
    return this.targets[child].map((target, frame) => subtract(target, this.joints[joint][frame]));
  }

  setTurns(joint, turns) {
    this.turns[joint] = turns;
    for (const child of childrenOf(this.parents, joint)) {
      this.joints[child] = turns.map((turn, frame) => add(this.joints[joint][frame], rotate(turn, this.offsets[child])));
      this.turns[child] = turns; // stays for the ends of limbs
    }
  }

  turnHub([hub]) {
    const children = childrenOf(this.parents, hub);
    const rest = children.map((child) => this.offsets[child]);
    this.setTurns(hub, this.joints[hub].map((place, frame) => bestRotation(rest, children.map((child) => subtract(this.targets[child][frame], place)))));
  }

  // Turns a joint with one child from `start` directly to its target.
  swing(joint, start = this.turns[this.parents[joint]]) {
    const [child] = childrenOf(this.parents, joint);
    this.setTurns(joint, this.aim(joint).map((aim, frame) => multiply(between(rotate(start[frame], this.offsets[child]), aim), start[frame])));
  }

  // Turns the first two joints of a limb; the plane in which its hinge bends gives the twist.
  turnLimb({ start, hinge, axis }, fps, rules) {
    this.swing(start); // moves the hinge
    const above = this.turns[this.parents[start]];
    const local = (aims) => aims.map((aim, frame) => unit(rotate(inverse(above[frame]), aim)));
    const turns = limbRotations(local(this.aim(start)), local(this.aim(hinge)), { direction: unit(this.offsets[hinge]), axis, fps, rules });
    this.setTurns(start, turns.map((turn, frame) => multiply(above[frame], turn)));
    this.swing(hinge);
  }
}

// Returns the ends of bones without children. A foot is level in the rest pose; when it stands flat, the bone to the toe goes
// down, and the tip of the shoe is as high as the toe.
function endSites(frames, offsets, parents, { ends, ankles, flat }) {
  const feet = ankles.map((ankle) => [ankle, childrenOf(parents, ankle)[0]]);
  const heights = frames.flatMap((frame) => feet.map(([, toe]) => frame[toe][1]));
  const low = heights.reduce((least, height) => Math.min(least, height)) + flat.height;
  const slopes = frames.flatMap((frame) => feet.map(([ankle, toe]) => -unit(subtract(frame[toe], frame[ankle]))[1]));
  const lowSlopes = slopes.filter((_, place) => heights[place] <= low).sort((a, b) => a - b);
  const slope = Math.min(Math.max(lowSlopes[Math.floor(flat.share * (lowSlopes.length - 1))], 0), flat.steepest);
  const found = offsets.map((offset, joint) => scaled(offset, ends[joint]));
  for (const [, toe] of feet) found[toe] = add(scaled(found[toe], Math.sqrt(1 - slope ** 2)), [0, slope * length(found[toe]), 0]);
  return found;
}

// Returns {offsets, ends, roots, turns, local}: the rest pose, ends of its bones, places of the root, and rotations in the world and below the parent.
export function fitRig(frames, { parents, fps }, rig) {
  const paths = parents.map((_, joint) => frames.map((frame) => frame[joint]));
  const offsets = restOffsets(paths, parents, rig);
  const fit = new Fit(rigidPaths(paths, offsets, parents, rig), offsets, parents);
  const [pelvis, chest] = rig.hubs;
  fit.turnHub(pelvis);
  for (const joint of rig.spine) fit.swing(joint);
  fit.turnHub(chest);
  // All twist of the spine is at the chest. Each of its joints gets a third.
  const [below, top] = [fit.turns[pelvis[0]], fit.turns[chest[0]]];
  rig.spine.forEach((joint, place) => fit.swing(joint, below.map((turn, frame) => slerp(turn, top[frame], (place + 1) / 3))));
  fit.setTurns(chest[0], top);
  for (const joint of chest.slice(1)) fit.swing(joint);
  for (const limb of rig.limbs) fit.turnLimb(limb, fps, rig.twist);
  for (const joint of rig.ankles) fit.swing(joint);
  const local = fit.turns.map((turns, joint) => turns.map((turn, frame) => (joint ? multiply(inverse(fit.turns[parents[joint]][frame]), turn) : turn)));
  const ends = endSites(frames, offsets, parents, rig);
  return { offsets, ends, roots: fit.joints[0], turns: fit.turns, local };
}

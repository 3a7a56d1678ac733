// Rotations of bones from joint positions. A rotation is a quaternion [x, y, z, w], as in glTF.

const dot = (a, b) => a.reduce((sum, value, place) => sum + value * b[place], 0);
const subtract = (a, b) => a.map((value, axis) => value - b[axis]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const length = Math.sqrt(dot(a, a)) || 1;
  return a.map((value) => value / length);
};
const IDENTITY = [0, 0, 0, 1];

export const inverse = ([x, y, z, w]) => [-x, -y, -z, w];

export function multiply([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

export const rotate = (turn, [x, y, z]) => multiply(multiply(turn, [x, y, z, 0]), inverse(turn)).slice(0, 3);

// Returns the shortest rotation from one direction to another.
export function between(from, to) {
  const [a, b] = [unit(from), unit(to)];
  const cosine = dot(a, b);
  if (cosine < -1 + 1e-9) { // opposite: about any axis across
    const across = unit(cross(a, Math.abs(a[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
    return [...across, 0];
  }
  return unit([...cross(a, b), 1 + cosine]);
}

// Returns the rotation from one pair of directions to another: the first to the first, and the second as close as can be.
function betweenPairs([across, up], [newAcross, newUp]) {
  const swing = between(across, newAcross);
  const axis = unit(newAcross);
  const flat = (vector) => subtract(vector, axis.map((value) => value * dot(vector, axis)));
  const [from, to] = [unit(flat(rotate(swing, up))), unit(flat(newUp))];
  const angle = Math.atan2(dot(cross(from, to), axis), dot(from, to));
  return multiply([...axis.map((value) => value * Math.sin(angle / 2)), Math.cos(angle / 2)], swing);
}

// Returns the world rotation of each joint for one frame, with the least twist that leads from `rest` to `joints`.
export function worldRotations(joints, rest, parents) {
  const children = parents.map((_, joint) => parents.flatMap((parent, child) => (parent === joint ? [child] : [])));
  const turns = [];
  joints.forEach((here, joint) => {
    const above = joint ? turns[parents[joint]] : IDENTITY;
    const directions = (places, child) => subtract(places[child], places[joint]);
    // A joint with three children: two at its sides, and one between them.
    const [right, middle, left] = children[joint].toSorted((a, b) => rest[a][0] - rest[b][0]);
    if (left !== undefined) {
      const pair = (places) => [subtract(places[left], places[right]), directions(places, middle)];
      turns.push(betweenPairs(pair(rest), pair(joints)));
    } else if (right !== undefined) {
      turns.push(multiply(between(rotate(above, directions(rest, right)), directions(joints, right)), above));
    } else turns.push(above);
  });
  return turns;
}

// Returns rotations and translations of joints in the frames of their parents: for each joint, a list over time.
export function localTracks(frames, rest, parents) {
  const tracks = parents.map(() => ({ rotations: [], translations: [] }));
  for (const joints of frames) {
    const turns = worldRotations(joints, rest, parents);
    tracks.forEach(({ rotations, translations }, joint) => {
      const back = joint ? inverse(turns[parents[joint]]) : IDENTITY;
      const turn = multiply(back, turns[joint]);
      const before = rotations.at(-1) ?? turn;
      rotations.push(dot(before, turn) < 0 ? turn.map((value) => -value) : turn); // the same rotation, without a jump
      translations.push(joint ? rotate(back, subtract(joints[joint], joints[parents[joint]])) : joints[0]);
    });
  }
  return tracks;
}

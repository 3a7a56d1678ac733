// An animated figure as a GLB file: the figure in its rest pose, which Python made, and an animation of its joints. All of
// them are where the motion has them: where the rigid bones of the figure lead elsewhere, their places are animated, too.

import { inverse, rotate } from "./rotations.js";
import { dot, scaled, subtract } from "./vectors.js";

const MAGIC = 0x46546c67; // "glTF", "JSON" and "BIN" as little-endian numbers
const JSON_CHUNK = 0x4e4f534a;
const BINARY_CHUNK = 0x004e4942;
const FLOAT = 5126;

function readChunks(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const size = view.getUint32(12, true);
  const tree = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + size)));
  return { tree, binary: bytes.subarray(28 + size, 28 + size + view.getUint32(20 + size, true)) };
}

function chunk(kind, bytes, filling) {
  const padded = new Uint8Array(Math.ceil(bytes.length / 4) * 4).fill(filling);
  padded.set(bytes);
  return [new Uint8Array(Uint32Array.of(padded.length, kind).buffer), padded];
}

// Returns a blob with the figure of `template`, the bytes of a GLB file, and one animation with the rotations of a fitted rig.
export function animatedFigure(template, frames, { turns, local }, { parents, fps }, { caption, part_starts, part_captions }) {
  const { tree, binary } = readChunks(template);
  const parts = [binary];
  let length = binary.length;
  const add = (values, width, extra = {}) => {
    const data = Float32Array.from(values.flat());
    tree.bufferViews.push({ buffer: 0, byteOffset: length, byteLength: data.byteLength });
    parts.push(new Uint8Array(data.buffer));
    length += data.byteLength;
    const type = { 1: "SCALAR", 3: "VEC3", 4: "VEC4" }[width];
    return tree.accessors.push({ bufferView: tree.bufferViews.length - 1, componentType: FLOAT, count: data.length / width, type, ...extra }) - 1;
  };
  const last = Math.fround((frames.length - 1) / fps);
  const input = add(frames.map((_, frame) => frame / fps), 1, { min: [0], max: [last] });
  const animation = { name: caption || "motion", samplers: [], channels: [], extras: { caption, fps, frames: frames.length, ...(part_starts.length ? { part_starts, part_captions } : {}) } };
  const follow = (node, path, output) => {
    animation.channels.push({ sampler: animation.samplers.push({ input, output }) - 1, target: { node, path } });
  };
  local.forEach((track, node) => {
    const parent = parents[node];
    const places = frames.map((joints, frame) => (node ? rotate(inverse(turns[parent][frame]), subtract(joints[node], joints[parent])) : joints[0]));
    follow(node, "rotation", add(withoutJumps(track), 4));
    follow(node, "translation", add(places, 3));
  });
  Object.assign(tree, { animations: [animation], buffers: [{ byteLength: length }] });
  const whole = new Uint8Array(length);
  parts.reduce((place, part) => {
    whole.set(part, place);
    return place + part.length;
  }, 0);
  const chunks = [...chunk(JSON_CHUNK, new TextEncoder().encode(JSON.stringify(tree)), 32), ...chunk(BINARY_CHUNK, whole, 0)];
  const size = chunks.reduce((sum, part) => sum + part.length, 12);
  return new Blob([new Uint8Array(Uint32Array.of(MAGIC, 2, size).buffer), ...chunks], { type: "model/gltf-binary" });
}

// Returns the same rotations with signs that do not change from frame to frame.
function withoutJumps(track) {
  let before = track[0];
  return track.map((turn) => {
    before = dot(before, turn) < 0 ? scaled(turn, -1) : turn;
    return before;
  });
}

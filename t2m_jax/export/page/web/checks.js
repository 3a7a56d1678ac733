// What comes as data is checked before it is used: a file list, a manifest and a figure with other content are refused in
// one line. Nothing of them becomes code, markup or an address.

const MOST_BYTES = 1_000_000_000;
const MOST_NUMBERS = 1e8; // of an array
const GRAPHS = {
  text: [["tokens", "num_tokens"], ["text_embedding"]],
  begin: [["text_embedding"], []],
  row: [["noise", "temperature", "may_stop"], ["codes", "stop_score"]],
  decode: [["codes", "num_rows"], ["features"]],
  place: [["features"], ["positions"]],
  calm: [["positions", "num_frames"], ["calm_positions"]],
  lock: [["calm_positions", "positions", "num_frames"], ["clean_positions"]],
};
const FINITE = ["text_embedding", "meaning", "features", "positions", "calm_positions", "clean_positions"];

function check(condition, file, what) {
  if (!condition) throw new Error(`${file}: ${what} is not as it must be; export the page again`);
}

const isRecord = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const isWhole = (value, low, high) => Number.isInteger(value) && value >= low && value <= high;
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const isShort = (value) => typeof value === "string" && value.length <= 300;
const isName = (value) => typeof value === "string" && /^\w{1,80}$/.test(value) && value !== "__proto__";
const isList = (value, isItem, most) => Array.isArray(value) && value.length <= most && value.every(isItem);
const isPoint = (point) => isList(point, isNumber, 3) && point.length === 3;

// Returns sizes and digests of the files by name.
export function checkFiles(tree) {
  const isFile = ([name, file]) =>
    /^(model|assets\/vendor)\/\w[\w.-]{1,80}$/.test(name) && isRecord(file) && isWhole(file.bytes, 0, MOST_BYTES) && /^[0-9a-f]{64}$/.test(file.sha256);
  check(isRecord(tree) && Object.entries(tree).every(isFile), "files.json", "the list");
  return new Map(Object.entries(tree));
}

const isShape = (shape) => isList(shape, (size) => isWhole(size, 0, 1e6), 8) && shape.reduce((product, size) => product * size, 1) <= MOST_NUMBERS;
const isArray = (array) => isRecord(array) && isShape(array.shape) && ["float32", "int32", "bool"].includes(array.dtype);
const isSide = (side) => isRecord(side) && Object.entries(side).every(([name, array]) => isName(name) && isArray(array));

function checkGraphs(graphs) {
  check(isRecord(graphs), "manifest.json", "graphs");
  for (const [name, [inputs, outputs]] of Object.entries(GRAPHS)) {
    const graph = graphs[name];
    check(isRecord(graph) && isSide(graph.inputs) && isSide(graph.outputs), "manifest.json", `the graph ${name}`);
    const has = (side, names) => names.every((one) => Object.hasOwn(side, one));
    check(has(graph.inputs, inputs) && has(graph.outputs, outputs), "manifest.json", `the graph ${name}`);
  }
  const { noise } = graphs.row.inputs;
  check(noise.shape.length === 3 && noise.shape[1] * noise.shape[2] <= 1e6, "manifest.json", "the noise");
  check(graphs.row.outputs.codes.shape.length === 2, "manifest.json", "the codes");
  check(graphs.place.inputs.features.shape.length === 3, "manifest.json", "the features");
}

function checkSampling({ max_rows: most, min_rows: least, state, next, guidance_scale: guidance, stop }) {
  check(isWhole(most, 1, 10_000) && isWhole(least, 0, most), "manifest.json", "the number of rows");
  check(isList(state, isName, 1000) && isName(next), "manifest.json", "the state");
  check(guidance === null || guidance === undefined || isNumber(guidance), "manifest.json", "guidance_scale");
  const rules = ["end", "threshold", "sampled", "argmax"];
  check(isRecord(stop) && rules.includes(stop.rule) && typeof stop.keeps_last === "boolean" && isNumber(stop.threshold), "manifest.json", "the stop rule");
}

// Returns the manifest.
export function checkManifest(tree) {
  const { sampling, motion, text, examples, license, source } = isRecord(tree) ? tree : {};
  check(tree?.format_version === 1, "manifest.json", "format_version");
  checkGraphs(tree.graphs);
  check(isRecord(sampling) && isRecord(motion) && isRecord(text), "manifest.json", "the content");
  checkSampling(sampling);
  check(isWhole(text.max_tokens, 1, 10_000), "manifest.json", "max_tokens");
  check(isNumber(motion.fps) && motion.fps > 0 && isWhole(motion.frames_per_row, 1, 1000), "manifest.json", "the frame rate");
  check(isList(motion.joints, isName, 200) && motion.joints.length > 0, "manifest.json", "the joints");
  const isParent = (parent, joint) => isWhole(parent, -1, joint - 1) && (parent < 0) === (joint === 0);
  check(isList(motion.parents, () => true, 200) && motion.parents.length === motion.joints.length && motion.parents.every(isParent), "manifest.json", "the parents");
  check(isList(motion.rest_offsets, isPoint, 200) && motion.rest_offsets.length === motion.joints.length, "manifest.json", "the rest pose");
  check(isList(examples, isShort, 1000) && isShort(license ?? "") && isShort(source ?? ""), "manifest.json", "the texts");
  return tree;
}

// Returns what the training data lack; `output` is the shape and type of what it is compared with.
export function checkMeanings(tree, output) {
  const { compared, sentences, learned, missing } = isRecord(tree) ? tree : {};
  const width = output?.shape[1];
  const isRow = (row) => isList(row, (value) => isWhole(value, -127, 127), 10_000) && row.length === width;
  check(isWhole(compared, 1, 100) && isList(sentences, isShort, 1000), "meanings.json", "the content");
  check([learned, missing].every((rows) => isList(rows, isRow, 1000) && rows.length > 0), "meanings.json", "the embeddings");
  check(missing.length === sentences.length, "meanings.json", "the embeddings");
  return tree;
}

// Returns the arrays that a graph has computed: of another shape, or not finite, they would become a wrong motion.
export function checkOutputs(name, outputs, tensors) {
  const arrays = Object.entries(outputs).map(([key, { dtype, shape }]) => {
    const { type, dims, data } = tensors[key] ?? {};
    const isFinite = !FINITE.includes(key) || data?.every(Number.isFinite);
    check(type === dtype && String(dims) === String(shape) && isFinite, `${name}.onnx`, `the output ${key}`);
    return [key, data];
  });
  return Object.fromEntries(arrays);
}

function checkRig({ names, directions, ends, hubs, spine, limbs, ankles, sweeps, twist }, parents) {
  const ofJoints = (list, isItem) => isList(list, isItem, parents.length) && list.length === parents.length;
  const isJoint = (joint) => isWhole(joint, 0, parents.length - 1);
  const count = (joint) => parents.filter((parent) => parent === joint).length;
  const isHub = (hub) => isList(hub, isJoint, 4) && hub.length === 4 && count(hub[0]) === 3;
  const bends = (joint) => isJoint(joint) && count(joint) === 1;
  const isLimb = (limb) => isRecord(limb) && bends(limb.start) && bends(limb.hinge) && isPoint(limb.axis);
  check(ofJoints(names, isName) && ofJoints(directions, isPoint) && ofJoints(ends, isNumber), "figure.json", "the rig");
  check(isList(hubs, isHub, 2) && hubs.length === 2 && hubs[1].slice(1).every(bends), "figure.json", "the rig");
  check(isList(spine, bends, 2) && isList(limbs, isLimb, 4) && isList(ankles, bends, 2) && isWhole(sweeps, 0, 100), "figure.json", "the rig");
  check(isRecord(twist) && isWhole(twist.angles, 1, 1000) && Object.values(twist).every((value) => isNumber(value) && value > 0), "figure.json", "the rig");
}

// Returns how a figure is drawn around joints with these parents.
export function checkFigure(tree, parents) {
  const joints = parents.length;
  const { weights, parts, head, roles, sizes, rig } = isRecord(tree) ? tree : {};
  const isRow = (row) => isList(row, isNumber, joints) && row.length === joints;
  check(isList(weights, isRow, 500) && weights.length >= joints, "figure.json", "weights");
  const points = weights.length + 2;
  const isPart = (part) => isList(part, isNumber, 5) && part.length === 5 && part.slice(0, 2).every((point) => isWhole(point, 0, points - 1)) && isWhole(part[4], 0, 3);
  check(isList(parts, isPart, 500) && isWhole(head, 0, points - 3), "figure.json", "parts");
  const isJoint = (joint) => isWhole(joint, 0, joints - 1);
  const named = isRecord(roles) ? [roles.neck, roles.tip, roles.leftShoulder, roles.rightShoulder, ...[roles.legs, roles.feet].flat(2)] : [];
  check(named.length === 12 && named.every(isJoint) && typeof tree.mirrored === "boolean", "figure.json", "roles");
  check(isRecord(sizes) && Object.values(sizes).flat().every(isNumber), "figure.json", "sizes");
  check(rig === null || isRecord(rig), "figure.json", "the rig");
  if (rig) checkRig(rig, parents);
  return tree;
}

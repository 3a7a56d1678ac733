// The recorded figures: unpacking, and the positions of their points at any time.

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

// Returns a figure with its points as numbers: x, y and z of each point of each frame.
function unpackFigure(record) {
  // A page that makes motions itself has the numbers.
  if (record.values) return { ...record, current: new Float32Array(3 * record.points) };
  const text = atob(record.data);
  const bytes = new Uint8Array(text.length);
  for (let place = 0; place < text.length; place++) bytes[place] = text.charCodeAt(place); // `from` takes ten times as long
  const view = new DataView(bytes.buffer);
  const stride = 3 * record.points;
  const values = new Float32Array(bytes.length / 2);
  for (let axis = 0; axis < stride; axis++) {
    // The data are second differences over time, modulo 2 ** 16.
    let [change, value] = [0, 0];
    for (let frame = 0; frame < record.frames; frame++) {
      change += view.getInt16(2 * (axis * record.frames + frame), true);
      value += change;
      values[frame * stride + axis] = ((value << 16) >> 16) * record.step + record.origin[axis % 3];
    }
  }
  return { ...record, data: null, values, current: new Float32Array(3 * record.points) };
}

// Returns a figure with the frames of another after its own.
function joinFigures(figure, next) {
  const values = new Float32Array(figure.values.length + next.values.length);
  values.set(figure.values);
  values.set(next.values, figure.values.length);
  const shifted = next.contacts.map(([first, last, ...place]) => [first + figure.frames, last + figure.frames, ...place]);
  return { ...figure, values, frames: figure.frames + next.frames, contacts: [...figure.contacts, ...shifted] };
}

// Cubic interpolation between the neighboring frames, exact on whole frames. Writes to figure.current.
function poseAt(figure, seconds) {
  const last = figure.frames - 1;
  const moment = clamp(seconds * figure.fps, 0, last);
  const frame = Math.min(Math.floor(moment + 1e-6), last);
  const t = Math.max(moment - frame, 0);
  const stride = 3 * figure.points;
  const at = (k) => clamp(frame + k, 0, last) * stride;
  const [before, here, next, after] = [at(-1), at(0), at(1), at(2)];
  const values = figure.values;
  const w0 = t * (-0.5 + t * (1 - 0.5 * t));
  const w1 = 1 + t * t * (-2.5 + 1.5 * t);
  const w2 = t * (0.5 + t * (2 - 1.5 * t));
  const w3 = t * t * (-0.5 + 0.5 * t);
  for (let i = 0; i < stride; i++) {
    figure.current[i] = w0 * values[before + i] + w1 * values[here + i] + w2 * values[next + i] + w3 * values[after + i];
  }
}

function rootAt(figure, frame) {
  const i = clamp(frame, 0, figure.frames - 1) * 3 * figure.points;
  return [figure.values[i], figure.values[i + 1], figure.values[i + 2]];
}

// Returns the mean of a list of points within `reach` places of each, which takes the sway of single steps away.
function smoothPath(path, reach) {
  return path.map((_, i) => {
    const sum = [0, 0, 0];
    for (let k = -reach; k <= reach; k++) {
      path[clamp(i + k, 0, path.length - 1)].forEach((value, axis) => { sum[axis] += value; });
    }
    return sum.map((value) => value / (2 * reach + 1));
  });
}

// Returns where the root is in each frame.
const rootPath = (figure) => Array.from({ length: figure.frames }, (_, frame) => rootAt(figure, frame));

// Returns the smallest box around all points of all frames.
function boundsOf(figure) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  figure.values.forEach((value, i) => {
    low[i % 3] = Math.min(low[i % 3], value);
    high[i % 3] = Math.max(high[i % 3], value);
  });
  return { low, high };
}

// The recorded figures: unpacking, and the positions of their points at any time.

function unpackFigure(record) {
  const bytes = Uint8Array.from(atob(record.data), (character) => character.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const values = new Float32Array(bytes.length / 2);
  for (let i = 0; i < values.length; i++) {
    values[i] = view.getInt16(2 * i, true) * record.step + record.origin[i % 3];
  }
  return { ...record, values, current: new Float32Array(3 * record.points) };
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

const rootAt = (figure, frame) => {
  const i = clamp(frame, 0, figure.frames - 1) * 3 * figure.points;
  return [figure.values[i], figure.values[i + 1], figure.values[i + 2]];
};

// The trail on the ground is smoothed, without the sway of single steps.
function trailAt(figure, frame) {
  let sum = [0, 0, 0];
  for (let k = -4; k <= 4; k++) sum = add(sum, rootAt(figure, clamp(frame, 0, figure.frames - 1) + k));
  return scale(sum, 1 / 9);
}

// The target of a following camera: the mean of all roots, smoothed over about a second, `rate` samples per second.
function followPath(figures, seconds, rate) {
  const count = Math.max(Math.ceil(seconds * rate) + 1, 1);
  const reach = Math.round(0.6 * rate);
  const middle = [];
  for (let i = 0; i < count; i++) {
    const roots = figures.map((figure) => rootAt(figure, Math.round((i / rate) * figure.fps)));
    middle.push(scale(roots.reduce(add), 1 / roots.length));
  }
  const smooth = (path) =>
    path.map((_, i) => {
      let sum = [0, 0, 0];
      for (let k = -reach; k <= reach; k++) sum = add(sum, path[clamp(i + k, 0, count - 1)]);
      return scale(sum, 1 / (2 * reach + 1));
    });
  return smooth(smooth(middle));
}

function bounds(figures) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const figure of figures) {
    for (let i = 0; i < figure.values.length; i++) {
      low[i % 3] = Math.min(low[i % 3], figure.values[i]);
      high[i % 3] = Math.max(high[i % 3], figure.values[i]);
    }
  }
  return { low, high };
}

// From sentences to a motion with the graphs of `t2m export onnx`; docs/engines.md explains each step.

import { easeSeams, fadeFeatures, inWindows } from "./chain.js";
import { foldIn, rowNoise, sampleKey } from "./random.js";

const SEGMENT_STREAM = 2 ** 30; // as in t2m_jax/sampling/segments.py

// Returns numbers as rows of so many.
const rowsOf = (numbers, width) => Array.from({ length: numbers.length / width }, (_, row) => [...numbers.subarray(row * width, (row + 1) * width)]);

export class Sampler {
  // `run(name, arrays)` resolves to the outputs of a graph, by name.
  constructor(manifest, tokenizer, run) {
    Object.assign(this, { manifest, tokenizer, run });
  }

  // Resolves to {text_embedding} and, if the model says what its data lack, {meaning}.
  async read(sentence) {
    const size = this.manifest.text.max_tokens;
    const tokens = this.tokenizer.encode(sentence).slice(0, size);
    const padded = Int32Array.from({ length: size }, (_, place) => tokens[place] ?? 0);
    return this.run("text", { tokens: padded, num_tokens: [tokens.length] });
  }

  get mostSentences() {
    const { lock, calm } = this.manifest.graphs;
    return lock.inputs.positions.shape[1] / calm.inputs.positions.shape[1];
  }

  // Resolves to the codes of a sentence as rows. `sentence` is the first one of the motion, `number` that of the one to sample.
  // `onRow` gets how many rows there are, and may throw to stop.
  async sample(embedding, { sentence, number, seed, sample, temperature, guidance, onRow }) {
    const rules = this.manifest.sampling;
    const { keeps_last: keepsLast, rule } = rules.stop;
    const [, depth, classes] = this.manifest.graphs.row.inputs.noise.shape;
    const first = sampleKey(seed, sentence, sample);
    const key = number ? foldIn(foldIn(first, SEGMENT_STREAM), number) : first;
    const rows = [];
    const scores = [];
    let state = await this.run("begin", { text_embedding: embedding, guidance_scale: [guidance ?? 1] });
    while (rows.length < rules.max_rows) {
      await onRow(rows.length);
      const noise = rowNoise(key, rows.length, { depth, classes });
      if (temperature === 0) noise.codes.fill(0); // the likeliest codes
      const mayStop = rows.length >= rules.min_rows - Number(keepsLast);
      const given = { noise: noise.codes, temperature: [temperature || 1], may_stop: [Number(mayStop)] };
      const found = await this.run("row", { ...given, ...state });
      state = Object.fromEntries(rules.state.map((name) => [name, found[rules.next + name]]));
      rows.push([...found.codes]);
      scores.push(mayStop ? found.stop_score[0] : -Infinity);
      if (this.#ends(scores.at(-1), noise.end)) return keepsLast ? rows : rows.slice(0, -1);
    }
    return rule === "argmax" ? rows.slice(0, scores.indexOf(Math.max(...scores)) + 1) : rows;
  }

  #ends(score, noise) {
    const { rule, threshold } = this.manifest.sampling.stop;
    if (rule === "end") return score > 0.5;
    if (rule === "threshold") return 1 / (1 + Math.exp(-score)) >= threshold;
    return rule === "sampled" && Math.fround(score + noise) > 0; // "argmax" ends nowhere, and is cut afterwards
  }

  // Resolves to {decoded, starts}: joint positions in meters, x, y and z of each joint of each frame, and the frames in which
  // sentences begin. `parts` has the rows of codes of each sentence.
  async decode(parts) {
    const { fps } = this.manifest.motion;
    const features = [];
    for (const rows of parts) {
      features.push(await this.#features(rows));
      if (features.length > 1) features.splice(-2, 2, ...fadeFeatures(features.at(-2), features.at(-1), fps));
    }
    const starts = features.map((_, number) => features.slice(0, number).reduce((sum, { length }) => sum + length, 0));
    const numbers = Float32Array.from(features.flat(2));
    const { positions } = await this.run("place", { features: this.#filled("place", "features", numbers) });
    return { starts, decoded: positions.slice(0, features.flat().length * this.#width) };
  }

  // Numbers of a frame of positions.
  get #width() {
    return 3 * this.manifest.motion.joints.length;
  }

  async #features(rows) {
    const { sampling, motion, graphs } = this.manifest;
    const codes = new Int32Array(sampling.max_rows * graphs.row.outputs.codes.shape[1]);
    codes.set(rows.flat());
    const { features } = await this.run("decode", { codes, num_rows: [rows.length] });
    return rowsOf(features, graphs.place.inputs.features.shape[2]).slice(0, rows.length * motion.frames_per_row);
  }

  // Resolves to positions that tremble less, with bones of constant length and feet that stand still. `seams` are the frames in
  // which a sentence follows another.
  async clean(positions, seams) {
    const { fps } = this.manifest.motion;
    const size = this.manifest.graphs.calm.inputs.positions.shape[1];
    const calm = async (rows) => {
      const numbers = Float32Array.from(rows.flat());
      const { calm_positions: found } = await this.run("calm", { positions: this.#filled("calm", "positions", numbers), num_frames: [rows.length] });
      return rowsOf(found, this.#width).slice(0, rows.length);
    };
    const eased = easeSeams(rowsOf(positions, this.#width), seams, fps);
    const flat = (rows) => this.#filled("lock", "positions", Float32Array.from(rows.flat()));
    const given = { calm_positions: flat(await inWindows(eased, size, fps, calm)), positions: flat(eased), num_frames: [eased.length] };
    return (await this.run("lock", given)).clean_positions.slice(0, positions.length);
  }

  // Returns numbers with zeros behind them, as many as an input of a graph has.
  #filled(graph, input, numbers) {
    const filled = new Float32Array(this.manifest.graphs[graph].inputs[input].shape.reduce((product, size) => product * size));
    filled.set(numbers);
    return filled;
  }
}

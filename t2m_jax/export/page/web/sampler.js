// From a sentence to a motion with the graphs of `t2m export onnx`; docs/engines.md explains each step.

import { rowNoise, sampleKey } from "./random.js";

export class Sampler {
  // `run(name, arrays)` resolves to the outputs of a graph, by name.
  constructor(manifest, tokenizer, run) {
    Object.assign(this, { manifest, tokenizer, run });
  }

  async embed(sentence) {
    const size = this.manifest.text.max_tokens;
    const tokens = this.tokenizer.encode(sentence).slice(0, size);
    const padded = Int32Array.from({ length: size }, (_, place) => tokens[place] ?? 0);
    return (await this.run("text", { tokens: padded, num_tokens: [tokens.length] })).text_embedding;
  }

  // Resolves to the codes of a motion as rows. `onRow` gets how many there are, and may throw to stop.
  async sample(embedding, { sentence, seed, sample, temperature, guidance, onRow }) {
    const rules = this.manifest.sampling;
    const { keeps_last: keepsLast, rule } = rules.stop;
    const [, depth, classes] = this.manifest.graphs.row.inputs.noise.shape;
    const key = sampleKey(seed, sentence, sample);
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

  // Resolves to joint positions in meters: x, y and z of each joint of each frame.
  async decode(rows) {
    const { sampling, motion, graphs } = this.manifest;
    const codes = new Int32Array(sampling.max_rows * graphs.row.outputs.codes.shape[1]);
    codes.set(rows.flat());
    const { positions } = await this.run("decode", { codes, num_rows: [rows.length] });
    return positions.slice(0, rows.length * motion.frames_per_row * motion.joints.length * 3);
  }

  // Resolves to positions that tremble less, with bones of constant length and feet that stand still.
  async clean(positions) {
    const numFrames = [positions.length / this.manifest.motion.joints.length / 3];
    const { calm_positions: calm } = await this.run("calm", { positions: this.#filled("calm", positions), num_frames: numFrames });
    const given = { calm_positions: this.#filled("lock", calm), positions: this.#filled("lock", positions), num_frames: numFrames };
    return (await this.run("lock", given)).clean_positions.slice(0, positions.length);
  }

  // Returns positions with zeros behind them, as many as a graph reads.
  #filled(graph, positions) {
    const { shape } = this.manifest.graphs[graph].inputs.positions;
    const filled = new Float32Array(shape.reduce((product, size) => product * size));
    filled.set(positions.subarray(0, filled.length));
    return filled;
  }
}

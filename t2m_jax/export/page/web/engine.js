// The worker that computes, so that the page can draw meanwhile. It gets {make: request} and {cancel: true}, and sends
// {loaded: share}, {ready}, {share}, {made}, {cancelled} and {failed: message}.

import * as ort from "./vendor/ort.min.js";
import { checkFigure, checkManifest, checkMeanings, checkOutputs } from "./checks.js";
import { Files } from "./files.js";
import { findMissing } from "./meanings.js";
import { Sampler } from "./sampler.js";
import { Tokenizer } from "./tokenizer.js";

const RUNTIME = "assets/vendor/ort.wasm.packed";
const TEMPLATE = "model/figure.glb"; // only of the skeleton that GLB files are written for
const MEANINGS = "model/meanings.json"; // only of models that say what their data lack
const GRAPHS = ["text", "begin", "row", "decode", "place", "calm", "lock"];
const MOST_THREADS = 4;
// To sort the weights for faster products takes longer than it saves in a hundred motions.
const OPTIONS = { executionProviders: ["wasm"], extra: { session: { disable_prepacking: "1" } } };
// The weights of the sentence encoder are stored in 8 bits. It runs once for a request, and to restore them then takes half
// of the memory that they would take as they are used.
const AS_STORED = { ...OPTIONS, graphOptimizationLevel: "disabled" };

class Cancelled extends Error {}

let isCancelled = false;
const send = (message) => postMessage(message);
// Lets messages come in between two rows.
const breathe = () => new Promise((resolve) => setTimeout(resolve));

// Resolves to a function that runs a graph with the types and shapes of the manifest. `contents` are promises of bytes.
async function openGraphs(manifest, contents) {
  const sessions = {};
  for (const [name, bytes] of Object.entries(contents)) {
    sessions[name] = await ort.InferenceSession.create(await bytes, name === "text" ? AS_STORED : OPTIONS);
  }
  return async (name, arrays) => {
    const { inputs, outputs } = manifest.graphs[name];
    const tensors = Object.fromEntries(Object.entries(inputs).map(([key, { dtype, shape }]) => [key, new ort.Tensor(dtype, arrays[key], shape)]));
    return checkOutputs(name, outputs, await sessions[name].run(tensors));
  };
}

async function open() {
  const files = await Files.open();
  const names = [RUNTIME, "model/manifest.json", "model/figure.json", "model/tokenizer.json", ...GRAPHS.map((name) => `model/${name}.onnx`)];
  const total = names.reduce((sum, name) => sum + files.sizeOf(name), 0);
  let [loaded, told] = [0, 0];
  const onBytes = (count) => {
    loaded += count;
    if (loaded / total < told + 0.01) return;
    told = loaded / total;
    send({ loaded: told });
  };
  // All at once: while one graph is prepared, the others come.
  const contents = Object.fromEntries(GRAPHS.map((name) => [name, files.bytes(`model/${name}.onnx`, onBytes)]));
  const runtime = files.unpacked(RUNTIME, onBytes);
  for (const promise of [runtime, ...Object.values(contents)]) promise.catch(() => {}); // told where it is awaited
  const manifest = checkManifest(await files.json("model/manifest.json", onBytes));
  const figure = checkFigure(await files.json("model/figure.json", onBytes), manifest.motion.parents);
  const tokenizer = new Tokenizer(await files.json("model/tokenizer.json", onBytes));
  ort.env.wasm.wasmBinary = await runtime;
  ort.env.wasm.numThreads = crossOriginIsolated ? Math.min(navigator.hardwareConcurrency || 1, MOST_THREADS) : 1;
  const template = files.has(TEMPLATE) ? await files.bytes(TEMPLATE) : null;
  const meanings = files.has(MEANINGS) ? checkMeanings(await files.json(MEANINGS), manifest.graphs.text.outputs.meaning) : null;
  const run = await openGraphs(manifest, contents);
  const { examples, license, source, motion, sampling, graphs } = manifest;
  const guidance = Object.hasOwn(graphs.begin.inputs, "guidance_scale") ? (sampling.guidance_scale ?? 1) : null;
  send({ ready: { examples, license, source, motion, figure, template, guidance, threads: ort.env.wasm.numThreads } });
  return { sampler: new Sampler(manifest, tokenizer, run), meanings };
}

// Resolves to what the training data lack, and motions {codes, starts, decoded, positions}; `starts` are the frames in which
// sentences begin.
async function make({ sampler, meanings }, { sentences, samples, ...options }) {
  const { max_rows: most } = sampler.manifest.sampling;
  if (sentences.length > sampler.mostSentences) throw new Error(`one motion shows at most ${sampler.mostSentences} sentences; leave some out`);
  const embeddings = [];
  const missing = new Set();
  for (const sentence of sentences) {
    const found = await sampler.read(sentence);
    embeddings.push(found.text_embedding);
    if (meanings) missing.add(findMissing(meanings, found.meaning));
  }
  const motions = [];
  for (let sample = 0; sample < samples; sample += 1) {
    const parts = [];
    for (const [number, embedding] of embeddings.entries()) {
      const onRow = async (row) => {
        await breathe();
        if (isCancelled) throw new Cancelled();
        send({ share: (sample + (number + row / most) / sentences.length) / samples });
      };
      parts.push(await sampler.sample(embedding, { ...options, sentence: sentences[0], number, sample, onRow }));
    }
    const { decoded, starts } = await sampler.decode(parts);
    motions.push({ codes: parts.flat(), starts, decoded, positions: await sampler.clean(decoded, starts.slice(1)) });
  }
  return { motions, missing: [...missing].filter(Boolean) };
}

const model = open();
model.catch((error) => send({ failed: error.message }));

onmessage = async ({ data }) => {
  isCancelled = data.cancel === true;
  if (isCancelled) return;
  try {
    send({ made: await make(await model, data.make) });
  } catch (error) {
    send(error instanceof Cancelled ? { cancelled: true } : { failed: error.message });
  }
};

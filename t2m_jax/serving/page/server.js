// Requests to the server. A busy server (429) is asked again after the time that it names.

import { ask, find } from "./dom.js";
import { labeled } from "./fields.js";
import { recallInTab, rememberInTab } from "./memory.js";

const DEFAULT_WAIT = 5;
let token = recallInTab("token"); // a variable, because a browser may forbid storage

export class ServerError extends Error {
  constructor(message) {
    super(labeled(message));
  }
}
export class LostConnection extends ServerError {}

// A link can bring the token (`?token=...`). It then leaves the address, so that it is not copied with it.
export function takeTokenFromAddress() {
  const address = new URL(location.href);
  if (!address.searchParams.has("token")) return;
  setToken(address.searchParams.get("token"));
  address.searchParams.delete("token");
  history.replaceState(null, "", address);
}

function setToken(given) {
  token = given;
  rememberInTab("token", given);
}

// Headers have bytes, and a token may have any letter.
const bytesOf = (text) => String.fromCharCode(...new TextEncoder().encode(text));

async function askForToken() {
  const input = find("token");
  find("token-refused").hidden = token === null;
  const answer = await ask(find("token-dialog"));
  if (answer !== "yes" || !input.value) return false;
  setToken(input.value);
  input.value = "";
  return true;
}

async function errorText(response) {
  try {
    const { error } = await response.json();
    if (error) return error;
  } catch {
    // A proxy answers with pages of its own, whose text would say nothing here.
  }
  return `The server answered with status ${response.status}.`;
}

export function pause(seconds, signal) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, 1000 * seconds);
    signal?.addEventListener("abort", () => {
      clearTimeout(timer);
      reject(signal.reason);
    });
  });
}

async function fetchOnce(path, options) {
  const headers = token === null ? options.headers : { ...options.headers, Authorization: `Bearer ${bytesOf(token)}` };
  try {
    return await fetch(path, { ...options, headers });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new LostConnection("The server cannot be reached.");
  }
}

async function send(path, options = {}, onWait = () => {}) {
  for (;;) {
    const response = await fetchOnce(path, options);
    if (response.ok) return response;
    if (response.status === 429) {
      const wait = Number(response.headers.get("Retry-After")) || DEFAULT_WAIT;
      onWait(wait);
      await pause(wait, options.signal);
    } else if (response.status !== 401 || !(await askForToken())) {
      throw new ServerError(await errorText(response));
    }
  }
}

const asJson = (data) => ({ method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(data) });

export async function fetchModel() {
  return (await send("model")).json();
}

function parseEvent(block) {
  const fields = {};
  for (const line of block.split("\n")) {
    const colon = line.indexOf(":");
    fields[line.slice(0, colon)] = line.slice(colon + 1);
  }
  return fields.event ? { name: fields.event.trim(), data: JSON.parse(fields.data) } : null;
}

// A request goes on under its key if the page is left. Only those who know the key can ask for it.
export const randomKey = () => [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");

// Yields the server-sent events {name, data} of a request for motions, up to the last one.
export async function* requestMotions(key, request, { signal, onWait }) {
  yield* readEvents(await send(`motions?keep=${key}`, { ...asJson(request), signal }, onWait), signal);
}

// Yields all events of a request that was sent before.
export async function* followMotions(key, { signal }) {
  yield* readEvents(await send(`motions/${key}`, { signal }), signal);
}

// Tells the server that nobody needs the motions any more, or that they are stored here.
export async function forgetMotions(key) {
  await send(`motions/${key}`, { method: "DELETE", keepalive: true }).catch(() => {}); // it forgets them by itself, later
}

async function* readEvents(response, signal) {
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read().catch((error) => {
      throw signal.aborted ? error : new LostConnection("The connection to the server was lost.");
    });
    if (done) throw new LostConnection("The connection ended before the motion was ready.");
    const blocks = (text + value).split("\n\n");
    text = blocks.pop();
    const events = blocks.map(parseEvent).filter(Boolean);
    yield* events;
    if (events.some(({ name }) => name === "done" || name === "failed")) return;
  }
}

// Returns {scene, motion} of a file's bytes; the parameters say its format and what is changed.
export async function readMotion(bytes, parameters) {
  const options = { method: "POST", headers: { "Content-Type": "application/octet-stream" }, body: bytes };
  return (await send(`scene?${new URLSearchParams(parameters)}`, options)).json();
}

// Returns a blob with a character's file and an animation for each motion; both are given as base64.
export async function moveCharacter(character, motions, parameters) {
  return (await send(`character?${new URLSearchParams(parameters)}`, asJson({ character, motions }))).blob();
}

// Returns a blob with a file that contains the motions, which are given as base64 of .npz files.
export async function makeFile(motions, parameters, onWait) {
  return (await send(`files?${new URLSearchParams(parameters)}`, asJson({ motions }), onWait)).blob();
}

// The files of the model, which are checked against the list of sizes and digests.

import { checkFiles } from "./checks.js";

const hex = (buffer) => [...new Uint8Array(buffer)].map((byte) => byte.toString(16).padStart(2, "0")).join("");

async function ask(name, cache = "default") {
  const response = await fetch(new URL(`../${name}`, import.meta.url), { cache, credentials: "omit", redirect: "error" });
  if (!response.ok || !response.body) throw new Error(`${name} cannot be read (status ${response.status})`);
  return response;
}

export class Files {
  #list;

  static async open() {
    const files = new Files();
    files.#list = checkFiles(await (await ask("files.json")).json());
    return files;
  }

  has(name) {
    return this.#list.has(name);
  }

  sizeOf(name) {
    const file = this.#list.get(name);
    if (!file) throw new Error(`${name} is not in files.json; export the page again`);
    return file.bytes;
  }

  // Resolves to the bytes of a file; `onBytes` is told how many have come.
  async bytes(name, onBytes = () => {}) {
    // What this browser keeps may be of another export or broken: then the server is asked once more.
    const data = (await this.#read(name, "default", onBytes)) ?? (await this.#read(name, "reload"));
    if (!data) throw new Error(`${name} is not the file that was exported`);
    return data;
  }

  // Resolves to the bytes, or to null if they are not those of the list.
  async #read(name, cache, onBytes = () => {}) {
    const data = new Uint8Array(this.sizeOf(name));
    const reader = (await ask(name, cache)).body.getReader();
    let size = 0;
    for (;;) {
      const { value, done } = await reader.read();
      if (done) break;
      if (size + value.length > data.length) {
        await reader.cancel();
        return null;
      }
      data.set(value, size);
      size += value.length;
      onBytes(value.length);
    }
    const isRight = size === data.length && hex(await crypto.subtle.digest("SHA-256", data)) === this.#list.get(name).sha256;
    return isRight ? data : null;
  }

  async json(name, onBytes) {
    return JSON.parse(new TextDecoder().decode(await this.bytes(name, onBytes)));
  }

  // Resolves to the content of a file that was compressed with gzip.
  async unpacked(name, onBytes) {
    const stream = new Blob([await this.bytes(name, onBytes)]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  }
}

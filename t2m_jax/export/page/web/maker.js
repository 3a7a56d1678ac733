// The page's side of the worker: one request at a time.

export class Maker {
  #worker;
  #waiting = null;

  // `onLoad` gets the share of the files that has come.
  constructor({ onLoad, onShare }) {
    Object.assign(this, { onLoad, onShare });
    this.#worker = new Worker(new URL("./engine.js", import.meta.url), { type: "module" });
    this.ready = this.#wait();
    this.#worker.onmessage = ({ data }) => this.#hear(data);
    this.#worker.onerror = (event) => this.#settle("reject", new Error(event.message || "the program that computes cannot be loaded"));
  }

  get isBusy() {
    return this.#waiting !== null;
  }

  #wait() {
    return new Promise((resolve, reject) => { this.#waiting = { resolve, reject }; });
  }

  #settle(how, value) {
    const waiting = this.#waiting;
    this.#waiting = null;
    waiting?.[how](value);
  }

  #hear(message) {
    if (message.loaded !== undefined) this.onLoad(message.loaded);
    else if (message.share !== undefined) this.onShare(message.share);
    else if (message.failed !== undefined) this.#settle("reject", new Error(message.failed));
    else this.#settle("resolve", message.ready ?? message.made ?? null);
  }

  // Resolves to {motions, missing} of the worker, or to null if the request was cancelled.
  make(request) {
    if (this.isBusy) throw new Error("another motion is being made");
    const made = this.#wait();
    this.#worker.postMessage({ make: request });
    return made;
  }

  cancel() {
    this.#worker.postMessage({ cancel: true });
  }
}

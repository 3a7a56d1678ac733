// One request at a time: its place in the queue, its progress with live frames, and its result.

import { clearMessage, find, once, seconds, showMessage, wantsMotion } from "./dom.js";
import { requestMotions, ServerError } from "./server.js";
import { makeTake } from "./session.js";

export class Generation {
  #abort = null;

  constructor({ session, stage, model, onDone }) {
    Object.assign(this, { session, stage, model, onDone });
    find("cancel").addEventListener("click", once(() => this.cancel()));
    session.onChange(["take"], () => { this.isWatched = false; });
  }

  get isRunning() {
    return this.#abort !== null;
  }

  // Whether the stage shows frames of a motion that is not ready.
  get #isLive() {
    return this.isWatched && [...this.live.values()].some(({ pieces }) => pieces.length > 0);
  }

  cancel() {
    this.#abort?.abort();
  }

  async run(request, kind) {
    if (this.isRunning) return;
    this.#begin();
    try {
      const take = await this.#receive(request, kind);
      this.#status(`Ready. Seed ${take.request.seed}.`);
      this.#end();
      const seen = this.#isLive ? this.stage.time : null; // the first frames may have been seen already
      this.onDone(take);
      if (seen !== null) this.stage.time = seen;
    } catch (error) {
      const cancelled = this.#abort.signal.aborted;
      this.#end();
      this.#status(cancelled ? "Canceled." : "");
      if (!cancelled) showMessage(error instanceof ServerError ? error.message : `The page has failed: ${error.message}`);
      if (this.#isLive) this.#showFormerTake();
    }
  }

  // The stage has shown frames of a motion that does not come.
  #showFormerTake() {
    const { take, selected, span } = this.session;
    this.session.show(take, selected);
    this.session.setSpan(span);
  }

  #begin() {
    clearMessage();
    this.#abort = new AbortController();
    this.live = new Map();
    this.isWatched = true; // until the user looks at another motion
    this.#showRunning(true);
    this.#status("Sent.");
    find("stage-frame").scrollIntoView({ block: "nearest" });
  }

  #end() {
    this.#abort = null;
    this.#showRunning(false);
  }

  #showRunning(running) {
    // The button that has the focus must not vanish under it.
    const focused = document.activeElement;
    find("generate").hidden = running;
    find("cancel").hidden = !running;
    find("stage-progress").hidden = !running;
    if (focused === find("generate")) find("cancel").focus();
    if (focused === find("cancel")) find("generate").focus();
  }

  #status(text) {
    find("status").textContent = text;
  }

  async #receive(request, kind) {
    const onWait = (wait) => this.#status(`The server is busy. Trying again in ${wait} s.`);
    const warnings = [];
    for await (const { name, data } of requestMotions(request, { signal: this.#abort.signal, onWait })) {
      if (name === "queued") this.#status(data.position === 0 ? "Next in the queue." : `${data.position} before you in the queue.`);
      if (name === "started") this.#status("Generating …");
      if (name === "codes") this.#showRows(data);
      if (name === "warning") warnings.push(data.message);
      if (name === "failed") throw new ServerError(data.error);
      if (name === "done") return this.#takeFrom(data, request, kind, warnings);
    }
    throw new ServerError("The connection ended before the motion was ready.");
  }

  #takeFrom(data, request, kind, warnings) {
    const { motion, ...options } = request; // the motion that was changed is a take of its own
    const { scene, motions, seed } = data;
    return makeTake({ kind, request: { ...options, seed }, scene, motions, warning: warnings.join(" ") });
  }

  // Adds the new frames of a sample to the stage, which already plays the former ones.
  #showRows({ sample, codes, scene }) {
    const live = this.live.get(sample) ?? { rows: 0, place: null, pieces: [] };
    this.live.set(sample, live);
    live.rows += codes.length;
    const rows = Math.max(...[...this.live.values()].map((one) => one.rows));
    this.#status(`Generating … ${seconds((rows * this.model.downsample) / this.model.fps)} made`);
    if (scene === null || !this.isWatched) return;
    live.pieces.push(scene.figures[0]);
    if (live.pieces.length > 1) this.stage.extend(live.place, scene.figures[0]);
    else this.#showLive(scene.seconds);
  }

  // Shows all samples that have frames, after the first frames of one.
  #showLive(sceneSeconds) {
    const shown = [...this.live.values()].filter(({ pieces }) => pieces.length > 0);
    this.stage.show({ seconds: sceneSeconds, figures: shown.map(({ pieces }) => pieces[0]) });
    shown.forEach((live, place) => {
      live.place = place;
      for (const piece of live.pieces.slice(1)) this.stage.extend(place, piece);
    });
    if (shown.length > 1) return;
    Object.assign(this.stage, { time: 0, range: null, playing: wantsMotion() });
    find("empty").hidden = true;
  }
}

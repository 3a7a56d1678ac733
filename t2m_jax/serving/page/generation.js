// One request at a time: its place in the queue, its progress with live frames, and its result.

import { clearMessage, find, once, showMessage, showNotice, wantsMotion } from "./dom.js";
import { recallInTab, rememberInTab } from "./memory.js";
import { Progress } from "./progress.js";
import { stepsAfter } from "./recipe.js";
import { followMotions, forgetMotions, LostConnection, pause, randomKey, requestMotions, ServerError } from "./server.js";
import { makeTake } from "./session.js";

const MOST_TRIES = 5;
const RETRY_SECONDS = 2;

let isLeaving = false;
addEventListener("pagehide", () => { isLeaving = true; });
addEventListener("pageshow", () => { isLeaving = false; });

export class Generation {
  #abort = null;

  constructor({ session, stage, onDone }) {
    Object.assign(this, { session, stage, onDone });
    this.progress = new Progress(find("stage-progress"), find("time-left"));
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

  // Makes motions of the user's request; `base` is the sample of a take that they change: {take, from}.
  async run(asked, kind, base) {
    if (this.isRunning) {
      showNotice("A motion is being made. Wait for it, or cancel it.");
      return;
    }
    const steps = base ? stepsAfter(base.take, base.from, { make: asked }) : [{ make: asked }];
    const running = { key: randomKey(), asked, kind, steps };
    rememberInTab("running", running);
    await this.#finish(running, await this.#work(running, this.#sender(running, base)));
  }

  // Returns the take of a request that is a step to another one, or null if the user cancels.
  make(asked, kind, base) {
    const running = { key: randomKey(), asked, kind };
    return this.#work(running, this.#sender(running, base)).finally(() => forgetMotions(running.key));
  }

  get isLeaving() {
    return isLeaving;
  }

  // Waits again for what this tab has asked for before it was reloaded.
  async resume() {
    const running = recallInTab("running");
    if (running) await this.#finish(running, await this.#work(running, (options) => followMotions(running.key, options)));
  }

  #sender({ key, asked }, base) {
    const { start, start_format, ...fields } = asked; // a link may name fields, but brings no files
    const request = base ? { ...fields, start: base.take.motions[base.from].npz } : fields;
    return (options) => requestMotions(key, request, options);
  }

  async #finish(running, take) {
    if (take !== null) {
      const seen = this.#isLive ? this.stage.time : null; // the first frames may have been seen already
      const stored = this.onDone(take);
      if (seen !== null) this.stage.time = seen;
      await stored;
    }
    if (!isLeaving && recallInTab("running")?.key === running.key) rememberInTab("running", null);
    if (!isLeaving) forgetMotions(running.key);
  }

  async #work(running, open) {
    this.#begin();
    const { signal } = this.#abort;
    try {
      const take = await this.#receive(running, open);
      this.#end(`Ready. Seed ${take.request.seed}.`);
      return take;
    } catch (error) {
      if (isLeaving) return null; // the browser ends the connections of a page that is left
      this.#end(signal.aborted ? "Canceled." : "");
      if (this.#isLive) this.#showFormerTake();
      if (!signal.aborted) showMessage(error instanceof ServerError ? error.message : `The page has failed: ${error.message}`);
      return null;
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
    this.isSent = false;
    this.isWatched = true; // until the user looks at another motion
    this.#showRunning(true);
    this.#status("Sent.");
    find("stage-frame").scrollIntoView({ block: "nearest" });
  }

  #end(status) {
    this.#abort = null;
    this.#showRunning(false);
    this.#status(status);
  }

  #showRunning(running) {
    // The button that has the focus must not vanish under it.
    const focused = document.activeElement;
    find("generate").hidden = running;
    find("cancel").hidden = !running;
    if (running) this.progress.show();
    else this.progress.hide();
    if (focused === find("generate")) find("cancel").focus();
    if (focused === find("cancel")) find("generate").focus();
  }

  #status(text) {
    find("status").textContent = text;
  }

  // Returns the take of a request; after a lost connection, it asks for the events again.
  async #receive(running, open) {
    const { signal } = this.#abort;
    const onWait = (wait) => this.#status(`The server is busy. Trying again in ${wait} s.`);
    for (let tries = 1; ; tries += 1) {
      try {
        return await this.#read(open({ signal, onWait }), running);
      } catch (error) {
        if (!this.isSent || isLeaving || tries === MOST_TRIES || !(error instanceof LostConnection)) throw error;
        this.#status("The connection was lost. Trying again …");
        await pause(RETRY_SECONDS, signal);
        open = (options) => followMotions(running.key, options);
      }
    }
  }

  async #read(events, running) {
    const warnings = [];
    for await (const { name, data } of events) {
      this.isSent = true;
      if (name === "queued") this.#status(data.position === 0 ? "Next in the queue." : `${data.position} before you in the queue.`);
      if (name === "started") this.#start();
      if (name === "codes") this.#showRows(data);
      if (name === "codes" || name === "progress") this.progress.set(data.share);
      if (name === "warning") warnings.push(data.message);
      if (name === "failed") throw new ServerError(data.error);
      if (name === "done") return takeFrom(running, data, warnings);
    }
  }

  // The model begins, perhaps anew.
  #start() {
    this.live = new Map();
    this.progress.start();
    this.#status("Generating …");
  }

  // Adds the new frames of a sample to the stage, which already plays the former ones.
  #showRows({ sample, scene }) {
    const live = this.live.get(sample) ?? { place: null, pieces: [] };
    this.live.set(sample, live);
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

function takeFrom({ key, asked, kind, steps }, { scene, motions, seed }, warnings) {
  const request = { ...asked, seed };
  // The server has chosen the seed if the user did not.
  const made = steps && [...steps.slice(0, -1), { ...steps.at(-1), make: request }];
  return makeTake({ id: key, kind, request, scene, motions, warning: warnings.join(" "), steps: made });
}

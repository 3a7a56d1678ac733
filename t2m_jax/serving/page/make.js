// The panel on the left: what is made (a new motion, or a change of the selected one), and with which options.

import { create, fillSelect, find, seconds, showMessage } from "./dom.js";
import { SentenceList } from "./sentences.js";
import { sentencesOf } from "./session.js";

const HINTS = {
  new: () => "",
  continue: () => "The sentences follow the selected motion.",
  redo: ({ span }) =>
    span ? `Replaces ${seconds(span[0])} to ${seconds(span[1])}; the rest is kept.` : "Choose the part on the timeline: drag its two handles, or click a sentence.",
  vary: () => "Other versions of the selected motion.",
};
const LARGEST_SEED = 2 ** 32 - 1;

export class MakePanel {
  #mode = "new";
  #drafts = {}; // what the user has written for each mode; without a draft, there is a suggestion

  constructor(session, model, generate) {
    Object.assign(this, { session, model });
    this.submit = () => {
      const request = this.#read();
      if (request !== null) generate(request, this.#mode);
    };
    this.sentences = new SentenceList(find("sentences"), find("add-sentence"), {
      limit: model.limits.captions,
      onSubmit: this.submit,
      onInput: () => { this.#drafts[this.#mode] = this.sentences.values; },
    });
    this.#fillOptions();
    this.#listen();
    this.setMode("new");
  }

  setMode(mode) {
    this.#mode = mode;
    const single = mode === "redo" || mode === "vary";
    this.sentences.single = single;
    this.#showSentences();
    find("strength-field").hidden = mode !== "vary";
    find("seconds-field").hidden = single;
    document.querySelector(`#modes [value=${mode}]`).checked = true;
  }

  // What was written has become a motion.
  forgetDraft(mode) {
    delete this.#drafts[mode];
  }

  // Begins what follows the selected motion: one more sentence.
  continueMotion() {
    this.setMode(this.session.motion ? "continue" : "new");
    this.sentences.focus();
  }

  reuseSeed(seed) {
    find("seed").value = seed;
  }

  #fillOptions() {
    const { model } = this;
    const counts = Array.from({ length: model.limits.num_samples }, (_, index) => [index + 1, index + 1]);
    fillSelect(find("num-samples"), counts);
    find("seconds").max = model.limits.seconds;
    find("guidance-field").hidden = !model.guided;
    if (model.guided) find("guidance").value = model.guidance_scale ?? 2;
    find("examples").append(...model.examples.map((text) => {
      const choose = () => {
        this.#drafts.new = [text];
        this.setMode("new");
        this.sentences.focus();
      };
      return create("button", { type: "button", className: "chip", textContent: text, onclick: choose });
    }));
    this.#showValues();
  }

  #showValues() {
    find("guidance-value").textContent = Number(find("guidance").value).toFixed(2);
    find("strength-value").textContent = `${Math.round(100 * find("strength").value)} %`;
  }

  #listen() {
    find("make").addEventListener("submit", (event) => {
      event.preventDefault();
      this.submit();
    });
    find("make").addEventListener("input", () => this.#showValues());
    find("modes").addEventListener("change", (event) => this.setMode(event.target.value));
    this.session.onChange(["take", "select"], () => this.#followTake());
    this.session.onChange(["span"], () => (this.#mode === "redo" ? this.#showSentences() : this.#showHint()));
    this.#enableModes();
  }

  #enableModes() {
    for (const input of document.querySelectorAll("#modes input")) {
      input.disabled = input.value !== "new" && !this.session.motion;
    }
  }

  #followTake() {
    this.#enableModes();
    if (!this.session.motion || this.session.take.kind === "comparison") return;
    this.#showSentences();
  }

  #showSentences() {
    this.sentences.values = this.#drafts[this.#mode] ?? this.#suggestion();
    this.#showHint();
  }

  #suggestion() {
    const { motion, span } = this.session;
    if (!motion || this.#mode === "continue") return [""];
    if (this.#mode === "new") return sentencesOf(motion);
    if (this.#mode === "vary" || !span || !motion.part_starts.length) return [motion.caption];
    const middle = ((span[0] + span[1]) / 2) * motion.fps;
    return [motion.part_captions[motion.part_starts.findLastIndex((start) => start <= middle)]];
  }

  #showHint() {
    find("mode-hint").textContent = HINTS[this.#mode](this.session);
  }

  #refuse(text, element) {
    showMessage(text);
    element.focus();
    return null;
  }

  // Returns the body of the request, or null after it said what is missing.
  #read() {
    const { motion, span } = this.session;
    const mode = this.#mode;
    const captions = this.sentences.values.map((text) => text.trim()).filter(Boolean);
    if (captions.length === 0) return this.#refuse("Write a sentence first.", this.sentences);
    const seed = find("seed").value.trim();
    if (seed && !(/^\d+$/.test(seed) && Number(seed) <= LARGEST_SEED)) {
      return this.#refuse(`The seed must be a whole number from 0 to ${LARGEST_SEED}, or empty.`, find("seed"));
    }
    if (!find("seconds").validity.valid) {
      return this.#refuse(`Seconds must be a number up to ${this.model.limits.seconds}, or empty.`, find("seconds"));
    }
    if (mode === "redo" && span === null) return this.#refuse(HINTS.redo(this.session), find("begin-handle"));
    const request = { captions, seed: seed ? Number(seed) : null, num_samples: Number(find("num-samples").value), variety: find("variety").value };
    const strength = Number(find("guidance").value);
    // Requests with the model's own strength can be generated in one batch with those of others.
    if (this.model.guided && strength !== this.model.guidance_scale) request.guidance_scale = strength;
    if (find("seconds").value && !find("seconds-field").hidden) request.seconds = Number(find("seconds").value);
    if (mode !== "new") Object.assign(request, { edit: mode, motion: motion.npz, motion_format: "npz" });
    if (mode === "redo") request.span = span;
    if (mode === "vary") request.strength = Number(find("strength").value);
    return request;
  }
}

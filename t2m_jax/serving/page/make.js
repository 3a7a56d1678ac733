// The panel on the left: what is made (a new motion, or a change of the selected one), and with which options.

import { create, fillSelect, find, seconds, showMessage } from "./dom.js";
import { complaint, findField, makeFields, plain, readFields, showField, wrongField } from "./fields.js";
import { keepForm, recall, recallInTab, remember, setValues } from "./memory.js";
import { SentenceList } from "./sentences.js";
import { sentencesOf } from "./session.js";
import { targetsIn } from "./targets.js";

const HINTS = {
  new: () => "",
  continue: () => "The sentences follow the selected motion.",
  insert: () => "The sentence comes in where the playhead is; what follows is kept.",
  redo: ({ span }) =>
    span ? `Replaces ${seconds(span[0])} to ${seconds(span[1])}; the rest is kept.` : "Choose the part on the timeline: drag its two handles, or click a sentence.",
  vary: () => "Other versions of the selected motion.",
};
const START_STRENGTH = 0.3;
const INSERTED_SECONDS = 2;
const EMPTY = { seed: "", num_samples: 1, temperature: "", seconds: "", guidance_scale: "", top_k: "", top_p: "", stop_rule: "", raw: false, whole: false, targets: "", candidates: "" };

const written = (texts) => texts.map((text) => text.trim()).filter(Boolean);

export class MakePanel {
  #mode = "new";
  #drafts = {}; // what the user has written for each mode; without a draft, there is a suggestion

  constructor(session, model, undo, { player, generate }) {
    Object.assign(this, { session, model, undo, player, generate });
    this.submit = () => {
      const request = this.#read();
      if (request !== null) generate(request, this.#mode, this.#mode === "new" ? null : this.#base);
    };
    this.sentences = new SentenceList(find("sentences"), find("add-sentence"), {
      limit: model.fields.motions.captions.maxItems,
      onSubmit: this.submit,
      onInput: (place) => this.#write(this.sentences.values, place),
    });
    this.#fillOptions();
    this.former = recallInTab("make")?.mode;
    keepForm(find("make"));
    this.#showValues();
    this.#listen();
    this.#drafts = recall("drafts") ?? {};
    this.setMode("new");
  }

  setMode(mode) {
    this.#mode = mode;
    this.sentences.fixed = mode !== "new" && mode !== "continue";
    this.#showSentences();
    find("strength-field").hidden = mode !== "vary";
    showField("seconds", mode !== "redo" && mode !== "vary");
    findField("seconds").placeholder = mode === "insert" ? INSERTED_SECONDS : "automatic";
    showField("stop_rule", this.model.stop_rules.length > 0 && (mode === "new" || mode === "continue")); // others have a length
    showField("candidates", mode === "redo" || mode === "insert");
    const hasTargets = mode === "new" || mode === "redo";
    showField("targets", hasTargets);
    find("targets").hidden = !hasTargets;
    find("targets").dispatchEvent(new Event("toggle"));
    document.querySelector(`#modes [value=${mode}]`).checked = true;
  }

  // Notes what the user has written; what is typed into one sentence (`place`) is undone together.
  #write(texts, place = null) {
    const mode = this.#mode;
    const before = this.#drafts[mode];
    this.#drafts[mode] = texts;
    remember("drafts", this.#drafts);
    const key = place === null ? null : `${mode} ${place}`;
    this.undo.push({ name: "writing", isDraft: true, key, undo: () => this.setDraft(mode, before), redo: () => this.setDraft(mode, texts) });
  }

  // Shows what was written before in a mode; without texts, the suggestion.
  setDraft(mode, texts) {
    if (texts) this.#drafts[mode] = texts;
    else delete this.#drafts[mode];
    remember("drafts", this.#drafts);
    this.setMode(this.session.motion ? mode : "new");
  }

  // What was written has become a motion of the sentences `sent`. Returns it, so that it can come back. If something else
  // was written meanwhile, that stays.
  forgetDraft(mode, sent = null) {
    const texts = this.#drafts[mode];
    if (sent !== null && `${texts && written(texts)}` !== `${sent}`) return undefined;
    delete this.#drafts[mode];
    remember("drafts", this.#drafts);
    return texts;
  }

  // Gives the controls the values of a request, if it is the only step of a motion.
  fill(steps) {
    if (steps.length > 1) return;
    setValues(find("make"), { ...EMPTY, ...steps[0].make });
    for (const name of ["input", "filled"]) findField("targets").dispatchEvent(new Event(name, { bubbles: true }));
    this.#showValues();
  }

  // Returns to what was made when the page was left, if that is possible with the selected motion.
  resume() {
    const mode = this.former;
    if (mode in HINTS && this.session.motion) this.setMode(mode);
  }

  // Begins what follows the selected motion: one more sentence.
  continueMotion() {
    this.setMode(this.session.motion ? "continue" : "new");
    this.sentences.focus();
  }

  // Replaces the sentence that is selected on the timeline; the others stay as they are.
  replaceSentence() {
    this.forgetDraft("redo"); // it was for another part
    this.setMode("redo");
    this.sentences.selectText();
  }

  // Begins a sentence that is inserted where the playhead is.
  insertSentence() {
    this.setMode(this.session.motion ? "insert" : "new");
    this.sentences.focus();
  }

  // Makes a part of the selected motion again, with another length; the rest is kept. Returns when that has ended.
  resize({ caption, span }, length) {
    const wrong = wrongField(find("make"));
    if (wrong) return this.#refuse(complaint(wrong), wrong);
    const { seed } = this.session.motion;
    const { targets, stop_rule, ...options } = readFields(find("make")); // these are for new motions
    return this.generate({ ...options, captions: [caption], seed, num_samples: 1, span, seconds: length }, "length", this.#base);
  }

  get #base() {
    return { take: this.session.take, from: this.session.selected };
  }

  reuseSeed(seed) {
    find("seed").value = seed;
  }

  #fillOptions() {
    const { model } = this;
    const fields = model.fields.motions;
    plain(fields.stop_rule).enum.splice(0, Infinity, ...model.stop_rules);
    makeFields(find("make"), fields, find("more-options"));
    showField("guidance_scale", model.guidance_scale !== null);
    findField("guidance_scale").placeholder = model.guidance_scale ?? "";
    const counts = Array.from({ length: fields.num_samples.maximum }, (_, index) => [index + 1, index + 1]);
    fillSelect(find("num-samples"), counts);
    const { minimum, maximum } = plain(fields.strength);
    Object.assign(find("strength"), { min: minimum, max: maximum, value: START_STRENGTH });
    this.largestSeed = plain(fields.seed).maximum;
    find("examples").parentElement.hidden = model.examples.length === 0;
    find("examples").append(...model.examples.map((text) => {
      const choose = () => {
        this.setMode("new");
        this.#write([text]);
        this.#showSentences();
        this.sentences.focus();
      };
      return create("button", { type: "button", className: "chip", textContent: text, onclick: choose });
    }));
    this.#showValues();
  }

  #showValues() {
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
    const suggestion = this.#suggestion();
    const draft = this.#drafts[this.#mode];
    // A draft of a variation is only for motions with as many sentences.
    const fits = draft && (this.#mode !== "vary" || draft.length === suggestion.length);
    this.sentences.values = fits ? draft : suggestion;
    this.#showHint();
  }

  #suggestion() {
    const { motion, span } = this.session;
    if (!motion || this.#mode === "continue" || this.#mode === "insert") return [""];
    if (this.#mode === "new" || this.#mode === "vary") return sentencesOf(motion);
    if (!span || !motion.part_starts.length) return [motion.caption];
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
    const { span } = this.session;
    const mode = this.#mode;
    const captions = written(this.sentences.values);
    if (captions.length === 0) return this.#refuse("Write a sentence first.", this.sentences);
    const seed = find("seed").value.trim();
    if (seed && !(/^\d+$/.test(seed) && Number(seed) <= this.largestSeed)) {
      return this.#refuse(`The seed must be a whole number from 0 to ${this.largestSeed}, or empty.`, find("seed"));
    }
    const wrong = wrongField(find("make"));
    if (wrong) return this.#refuse(complaint(wrong), wrong);
    if (mode === "redo" && span === null) return this.#refuse(HINTS.redo(this.session), find("begin-handle"));
    const request = { captions, seed: seed ? Number(seed) : null, num_samples: Number(find("num-samples").value), ...readFields(find("make")) };
    if (mode === "redo") Object.assign(request, { span, targets: targetsIn(request.targets ?? "", span) || undefined });
    const now = Math.min(this.player.time, this.session.motion?.seconds ?? 0); // other samples may be longer
    if (mode === "insert") Object.assign(request, { seconds: INSERTED_SECONDS, ...request, span: [now, now] });
    if (mode === "vary") request.strength = Number(find("strength").value);
    return request;
  }
}

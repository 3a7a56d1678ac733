// Puts the parts of the page together.

import { clearMessage, create, fillSelect, find, showMessage, showNotice } from "../studio/dom.js";
import { Player } from "../studio/player.js";
import { Progress } from "../studio/progress.js";
import { makeTake, partsOf, Session } from "../studio/session.js";
import { makeFigure } from "./figure.js";
import { Maker } from "./maker.js";
import { prepareOffline } from "./offline.js";
import { Past } from "./past.js";
import { captionOf, checkRecipe, linkOf, MOST_SAMPLES, recipeFromAddress, sentencesOf } from "./recipe.js";
import { offerDownloads } from "./save.js";
import { leftToModel } from "./sentence.js";

const FIELDS = ["sentence", "seed", "samples", "temperature", "guidance"];
const USUAL = { sentence: "", seed: "", samples: "1", temperature: "1" };

class Page {
  constructor() {
    this.session = new Session();
    this.stage = new T2M.Stage(find("stage"));
    this.player = new Player(this.stage, this.session);
    this.progress = new Progress(find("stage-progress"), find("time-left"));
    this.past = new Past((recipe) => this.open(recipe));
    fillSelect(find("samples"), Array.from({ length: MOST_SAMPLES }, (_, index) => [`${index + 1}`, `${index + 1}`]));
    find("make").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#try(() => this.make(checkRecipe(this.#form())));
    });
    find("sentence").addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.shiftKey || event.isComposing) return;
      event.preventDefault();
      find("make").requestSubmit();
    });
    find("add-sentence").addEventListener("click", () => {
      const field = find("sentence");
      field.value = field.value.trim() && `${field.value.trimEnd()}\n`;
      field.focus();
    });
    find("cancel").addEventListener("click", () => this.maker.cancel());
    find("share").addEventListener("click", () => this.#share());
    this.session.onChange(["take", "select"], () => this.#tell());
    this.stage.onchange = () => this.#update();
    this.#update();
  }

  async start() {
    this.#setBusy("Loading the model …", false);
    await prepareOffline();
    this.maker = new Maker({ onLoad: (share) => this.progress.set(share), onShare: (share) => this.progress.set(share) });
    this.model = await this.maker.ready;
    this.#describe();
    this.#setBusy(null);
    this.#status(`Ready. It computes in this browser, with ${this.model.threads === 1 ? "1 thread" : `${this.model.threads} threads`}.`);
    addEventListener("hashchange", () => this.#followLink());
    await this.#followLink();
  }

  get #usual() {
    return { ...USUAL, guidance: this.model.guidance === null ? null : String(this.model.guidance) };
  }

  #describe() {
    const { source, license, examples, guidance } = this.model;
    find("model-name").textContent = source ?? "";
    find("license").textContent = license ? `The model's license is ${license}.` : "The model names no license.";
    find("guidance-field").hidden = guidance === null;
    find("guidance").value = guidance ?? "";
    find("examples").replaceChildren(...examples.map((text) => create("button", {
      type: "button", className: "chip", textContent: text, dir: "auto", onclick: () => {
        find("sentence").value = text;
        find("sentence").focus();
      },
    })));
    offerDownloads(this.session, this.model);
  }

  #form() {
    const values = Object.fromEntries(FIELDS.map((name) => [name, find(name).value]));
    return { ...values, guidance: this.model.guidance === null ? null : values.guidance };
  }

  #fill(recipe) {
    for (const name of FIELDS) if (recipe[name] !== null) find(name).value = recipe[name];
  }

  #followLink() {
    return this.#try(async () => {
      const recipe = recipeFromAddress(this.#usual);
      if (recipe) await this.open(recipe);
    });
  }

  // Shows the motion of a recipe, which is made if it is not there.
  async open(recipe) {
    this.#fill(recipe);
    const take = this.past.takeOf(recipe);
    if (take) this.#show(take);
    else await this.#try(() => this.make(recipe));
  }

  async make(recipe) {
    if (!this.model || this.maker.isBusy) {
      showNotice("A motion is being made. Wait for it, or cancel it.");
      return;
    }
    clearMessage();
    this.#setBusy("Making the motion …");
    const begin = performance.now();
    try {
      const made = await this.maker.make({ ...recipe, sentences: sentencesOf(recipe) });
      if (made === null) this.#status("Cancelled.");
      else {
        this.#show(this.#takeOf(recipe, made.motions));
        const lacks = made.missing.map((text) => ` The training data have no motion like “${text}”.`).join("");
        const left = sentencesOf(recipe).flatMap(leftToModel).map((text) => `“${text}”`);
        const note = left.length ? ` Order, counts and lengths are left to the model here (${left.join(", ")}). Write each action on a line of its own.` : "";
        this.#status(`Ready in ${((performance.now() - begin) / 1000).toFixed(1)} s. Seed ${recipe.seed}.${lacks}${note}`);
      }
    } finally {
      this.#setBusy(null);
    }
  }

  #takeOf(recipe, made) {
    const { motion, figure } = this.model;
    const shown = made.filter(({ codes }) => codes.length > 0);
    if (shown.length === 0) throw new Error("the model made an empty motion; try another seed");
    const caption = captionOf(recipe);
    const captions = sentencesOf(recipe).length > 1 ? sentencesOf(recipe) : [];
    const figures = shown.map(({ positions, starts }) => {
      const sentences = captions.map((text, place) => [starts[place], text]);
      return makeFigure(positions, { figure, motion, caption, sentences });
    });
    const motions = shown.map(({ codes, starts, decoded, positions }, place) => {
      const { frames, fps } = figures[place];
      const parts = { part_starts: captions.length ? starts : [], part_captions: captions };
      return { caption, ...parts, seed: recipe.seed, codes, decoded, positions, frames, fps, seconds: frames / fps };
    });
    const seconds = Math.max(...motions.map((one) => one.seconds));
    return makeTake({ kind: "new", request: recipe, scene: { seconds, figures }, motions });
  }

  #show(take) {
    this.session.show(take);
    this.past.add(take);
    // Whoever reloads the page, or copies its address, has the same motion.
    window.history.replaceState(null, "", linkOf(take.request));
  }

  #tell() {
    const { take, motion, selected } = this.session;
    find("empty").hidden = motion !== null;
    find("take-title").textContent = motion?.caption ?? "No motion yet";
    const place = take?.motions.length > 1 ? [`${selected + 1} of ${take.motions.length}`] : [];
    find("take-facts").textContent = motion ? [...place, `${motion.seconds.toFixed(2)} s`, `${motion.frames} frames`, `${motion.fps} fps`, `seed\u00a0${motion.seed}`].join(" · ") : "";
    this.#showParts(motion);
    find("take-actions").hidden = motion === null;
    find("timeline").classList.toggle("idle", motion === null);
    for (const element of find("timeline").querySelectorAll("button, input, select")) element.disabled = motion === null;
  }

  // Shows the sentences of a motion below its time, if there are several.
  #showParts(motion) {
    const parts = motion?.part_starts.length ? partsOf(motion) : [];
    find("parts").hidden = parts.length === 0;
    find("parts").replaceChildren(...parts.map(({ caption, span: [begin, end] }) => {
      const button = create("button", { type: "button", className: "quiet", title: caption, dir: "auto", textContent: caption, onclick: () => this.player.seek(Math.round(begin * motion.fps)) });
      button.style.flexGrow = end - begin;
      return button;
    }));
  }

  #update() {
    this.player.update();
    find("scrub").max = this.player.lastFrame;
    find("scrub").value = this.player.frame;
    find("scrub").setAttribute("aria-valuetext", `Frame ${this.player.frame} of ${this.player.lastFrame}`);
  }

  async #share() {
    const link = linkOf(this.session.take.request);
    try {
      await navigator.clipboard.writeText(link);
      showNotice("The link is copied. Whoever opens it sees the same motion.");
    } catch {
      showNotice("The address of this page is the link. Whoever opens it sees the same motion.");
    }
  }

  #status(text) {
    find("status").textContent = text;
  }

  #setBusy(text, canCancel = true) {
    if (text === null) this.progress.hide();
    else this.progress.show();
    if (text !== null) this.#status(text);
    find("generate").hidden = text !== null && canCancel;
    find("generate").disabled = text !== null;
    find("cancel").hidden = text === null || !canCancel;
  }

  async #try(action) {
    try {
      await action();
    } catch (error) {
      this.#status("");
      showMessage(`This cannot be done: ${error.message}.`);
    }
  }
}

const page = new Page();
page.start().catch((error) => {
  find("status").textContent = "";
  find("stage-progress").hidden = true;
  showMessage(`The page cannot start: ${error.message}.`);
});

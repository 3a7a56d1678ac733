// The download panel: the selected motion, or all of a take, changed if need be, as a file in one of several formats.

import { clearMessage, create, find, seconds, showMessage } from "./dom.js";
import { clearFields, complaint, findField, makeFields, plain, readFields, showField, wrongField } from "./fields.js";
import { keepForm, recallInTab, rememberInTab, setValues } from "./memory.js";
import { changeSample } from "./recipe.js";
import { fileName, saveBlob } from "./savefile.js";
import { makeFile, ServerError } from "./server.js";

const TITLES = { npz: "Arrays for Python", bvh: "Skeleton for Blender, Maya …", glb: "Animated figure, glTF", vrma: "For any VRM avatar", gif: "Picture", mp4: "Video", png: "Poses in one picture", html: "Page with a viewer" };

export class DownloadPanel {
  constructor(session, model, onChanged) {
    Object.assign(this, { session, onChanged, several: model.formats_of_several, options: model.file_options, form: find("save") });
    const formats = plain(model.fields.files.format).enum;
    makeFields(this.form, model.fields.files, find("more-changes"));
    find("formats").append(...formats.map((format) => this.#formatChoice(format)));
    this.form.elements.format.value = formats.includes("glb") ? "glb" : formats[0];
    this.former = recallInTab(this.form.id) ?? {};
    keepForm(this.form);
    // Fields that only some formats have, and what the user has chosen there.
    const names = new Set(Object.values(model.file_options).flatMap(Object.keys));
    const before = recallInTab("file-options") ?? {};
    this.wanted = new Map([...names].filter((name) => name in model.fields.files).map((name) => [name, before[name] ?? findField(name).value]));
    addEventListener("pagehide", () => rememberInTab("file-options", Object.fromEntries(this.wanted)));
    this.form.addEventListener("change", ({ target }) => {
      if (this.wanted.has(target.dataset.field)) this.wanted.set(target.dataset.field, target.value);
      this.#update();
    });
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.save();
    });
    find("apply-changes").addEventListener("click", () => this.apply());
    session.onChange(["take", "select", "span"], () => this.#update());
    this.#update();
  }

  // Returns to what was chosen for the motion and the span that were shown when the page was left.
  resume() {
    setValues(this.form, { "save-span": this.former["save-span"] });
  }

  get format() {
    return this.form.elements.format.value;
  }

  #formatChoice(format) {
    const input = create("input", { type: "radio", name: "format", value: format });
    return create("label", { title: TITLES[format] ?? "" }, input, create("span", { textContent: format.toUpperCase() }));
  }

  #update() {
    const { take, span, motion } = this.session;
    this.#showOptions();
    this.#offer("save-span", span !== null);
    find("save-span-text").textContent = span ? `(${seconds(span[0])} to ${seconds(span[1])})` : "";
    this.#offer("save-all", (take?.motions.length ?? 0) > 1);
    find("save-button").disabled = find("apply-changes").disabled = motion === null || this.busy === true;
    find("save-button").textContent = this.busy ? "Making the file …" : `Download ${this.format.toUpperCase()}`;
  }

  // Shows what the format has. A choice that it does not have comes back with a format that has it.
  #showOptions() {
    for (const [name, wanted] of this.wanted) {
      const values = this.options[this.format][name] ?? [];
      const control = findField(name);
      showField(name, values.length > 0);
      for (const option of control.options ?? []) option.hidden = option.disabled = option.value !== "" && !values.includes(option.value);
      if (control.options) control.value = values.includes(wanted) ? wanted : "";
    }
  }

  #offer(id, possible) {
    const input = find(id);
    input.closest("label").hidden = !possible;
    // A span that the user has just chosen is what they want to have.
    if (possible && input.disabled && id === "save-span") input.checked = true;
    input.disabled = !possible;
  }

  // What the fields and the span of the timeline change.
  changes() {
    const { span } = this.session;
    const changes = readFields(find("changes"));
    if (span && find("save-span").checked) Object.assign(changes, { begin: span[0].toFixed(4), end: span[1].toFixed(4) });
    return changes;
  }

  // Does something that asks the server; meanwhile, the buttons are disabled.
  async #work(action) {
    const wrong = wrongField(this.form);
    if (this.session.motion === null || this.busy) return;
    clearMessage();
    if (wrong) {
      showMessage(complaint(wrong));
      wrong.focus();
      return;
    }
    this.busy = true;
    this.#update();
    try {
      await action(this.session);
    } catch (error) {
      showMessage(error instanceof ServerError ? error.message : `This could not be done: ${error.message}`);
    } finally {
      this.busy = false;
      this.#update();
    }
  }

  // The changed motion becomes a motion of its own, which can be changed again.
  apply() {
    return this.#work(async ({ take, selected }) => {
      const changed = await changeSample(take, selected, this.changes());
      clearFields(find("changes"));
      this.onChanged(changed);
    });
  }

  save() {
    return this.#work(async ({ take, motion }) => {
      const chosen = !find("save-all").disabled && find("save-all").checked ? take.motions : [motion];
      const parameters = { ...readFields(this.form), ...this.changes(), format: this.format };
      // Formats for one motion become several files.
      const files = this.several.includes(parameters.format) ? [chosen] : chosen.map((one) => [one]);
      for (const [number, motions] of files.entries()) {
        const blob = await makeFile(motions.map(({ npz }) => npz), parameters, (wait) => {
          find("save-button").textContent = `Busy, trying again in ${wait} s`;
        });
        saveBlob(blob, fileName(motions[0], files.length > 1 ? number + 1 : null, parameters.format));
      }
    });
  }
}

// The download panel: the selected motion, or all of a take, as a file in one of several formats.

import { clearMessage, create, fillSelect, find, seconds, showMessage } from "./dom.js";
import { makeFile, ServerError } from "./server.js";

const TITLES = { npz: "Arrays for Python", bvh: "Skeleton for Blender, Maya …", glb: "Animated figure, glTF", gif: "Picture", mp4: "Video", png: "Poses in one picture", html: "Page with a viewer" };
const SEVERAL = ["glb", "html", "mp4", "gif", "png"];

export class DownloadPanel {
  constructor(session, model) {
    this.session = session;
    this.several = model.formats_of_several ?? SEVERAL;
    this.form = find("save");
    find("formats").append(...model.formats.map((format) => this.#formatChoice(format)));
    fillSelect(find("save-fps"), [["", "As it is"], ...model.fps_choices.map((fps) => [fps, fps])]);
    fillSelect(find("save-names"), [["", "Standard"], ...model.joint_names.map((name) => [name, name])]);
    this.form.elements.format.value = model.formats.includes("glb") ? "glb" : model.formats[0];
    this.form.addEventListener("change", () => this.#update());
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.save();
    });
    session.onChange(["take", "select", "span"], () => this.#update());
    this.#update();
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
    for (const field of this.form.querySelectorAll("[data-formats]")) {
      field.hidden = !field.dataset.formats.split(" ").includes(this.format);
    }
    this.#offer("save-span", span !== null);
    find("save-span-text").textContent = span ? `(${seconds(span[0])} to ${seconds(span[1])})` : "";
    this.#offer("save-all", (take?.motions.length ?? 0) > 1);
    find("save-button").disabled = motion === null || this.busy === true;
    find("save-button").textContent = this.busy ? "Making the file …" : `Download ${this.format.toUpperCase()}`;
  }

  #offer(id, possible) {
    const input = find(id);
    input.closest("label").hidden = !possible;
    // A span that somebody has just chosen is what they want to have.
    if (possible && input.disabled) input.checked = id === "save-span";
    input.disabled = !possible;
  }

  #parameters() {
    const parameters = { format: this.format };
    for (const [name, id] of [["fps", "save-fps"], ["names", "save-names"], ["units", "save-units"]]) {
      const field = find(id);
      if (field.value && !field.closest("label").hidden) parameters[name] = field.value;
    }
    for (const [name, id] of [["in_place", "save-in-place"], ["loop", "save-loop"]]) {
      if (find(id).checked) parameters[name] = "1";
    }
    const { span } = this.session;
    if (span && find("save-span").checked) Object.assign(parameters, { begin: span[0].toFixed(4), end: span[1].toFixed(4) });
    return parameters;
  }

  async save() {
    const { take, motion } = this.session;
    if (motion === null || this.busy) return;
    clearMessage();
    this.busy = true;
    this.#update();
    const chosen = !find("save-all").disabled && find("save-all").checked ? take.motions : [motion];
    const parameters = this.#parameters();
    // Formats for one motion become several files.
    const files = this.several.includes(parameters.format) ? [chosen] : chosen.map((one) => [one]);
    try {
      for (const [number, motions] of files.entries()) {
        const blob = await makeFile(motions.map(({ npz }) => npz), parameters, (wait) => {
          find("save-button").textContent = `Busy, trying again in ${wait} s`;
        });
        saveBlob(blob, fileName(motions[0], files.length > 1 ? number + 1 : null, parameters.format));
      }
    } catch (error) {
      showMessage(error instanceof ServerError ? error.message : `The file could not be saved: ${error.message}`);
    } finally {
      this.busy = false;
      this.#update();
    }
  }
}

function fileName(motion, number, format) {
  const words = motion.caption.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-|-$/g, "");
  return [[...words].slice(0, 40).join("") || "motion", motion.seed, number].filter((part) => part !== null && part !== undefined).join("-") + `.${format}`;
}

function saveBlob(blob, download) {
  const href = URL.createObjectURL(blob);
  create("a", { href, download }).click();
  setTimeout(() => URL.revokeObjectURL(href), 60_000); // the browser may still be reading it
}

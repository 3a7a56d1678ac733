// The user's own character: chosen here, moved by the server, shown in place of the figures, and saved as a file.

import { clearMessage, find, showMessage } from "./dom.js";
import { fileName, saveBlob } from "./savefile.js";
import { LostConnection, moveCharacter, ServerError } from "./server.js";

export class CharacterPanel {
  #character = null;
  #earlier = []; // those that come back if the server refuses the one that was chosen after them
  #shown = 0; // counts what was asked for, so that a late answer is not shown

  constructor(session, model, stage, changes) {
    Object.assign(this, { session, model, stage, changes });
    const input = find("character-input");
    find("choose-character").addEventListener("click", () => input.click());
    input.addEventListener("change", () => {
      if (input.files[0]) this.choose([...input.files]);
      input.value = ""; // so that the same file can be chosen again
    });
    find("remove-character").addEventListener("click", () => {
      this.#earlier = [];
      this.#keep(null);
      this.#use(null);
    });
    find("save-character").addEventListener("click", () => this.save());
    session.onChange(["take"], () => this.#show());
    this.#use(null);
  }

  // Shows the character that was chosen before the page was left. Without a store, it lasts until then.
  async resume(store) {
    this.store = store;
    const { id, ...character } = (await store?.character()) ?? {};
    if (id && this.#character === null) await this.#use(character);
  }

  async choose(files) {
    clearMessage();
    try {
      const character = await readCharacter(files, this.model.character_bytes);
      if (this.#character) this.#earlier.push(this.#character);
      this.#keep(character);
      await this.#use(character);
    } catch (error) {
      showMessage(error instanceof ServerError ? error.message : `${files[0].name}: ${error.message}`);
    }
  }

  #keep(character) {
    this.store?.setCharacter(character).catch(() => {
      showMessage("The browser cannot keep the character: after a reload, choose it again.");
    });
  }

  // Shows a character from now on, or the figure again. In place of one that the server refuses, the one before comes back.
  async #use(character) {
    this.#character = character;
    this.session.take?.motions.forEach((_, k) => this.stage.dress(k));
    await this.#show();
  }

  async #show() {
    const { take } = this.session;
    const character = this.#character;
    const number = ++this.#shown;
    const isCurrent = () => number === this.#shown;
    this.#update(character && take ? "The character is being moved …" : "");
    if (character === null || take === null) return;
    try {
      const bytes = await (await this.#ask(take.motions)).arrayBuffer();
      if (isCurrent()) this.#earlier = [];
      for (const k of take.motions.keys()) {
        const body = await T2M.loadCharacter(bytes, take.motions.length - k).catch((error) => {
          throw new ServerError(`${character.name}: cannot be drawn here (${error.message}), but downloaded`);
        });
        if (!isCurrent()) return;
        this.stage.dress(k, body);
      }
    } catch (error) {
      if (isCurrent()) this.#fail(error, character);
    } finally {
      if (isCurrent()) this.#update("");
    }
  }

  // The server refuses a character or a motion with the first request, so the character is of no use.
  #fail(error, character) {
    showMessage(error instanceof ServerError ? error.message : `${character.name}: ${error.message}`);
    if (/cannot be drawn here/.test(error.message)) return;
    const former = this.#earlier.pop() ?? null;
    if (!(error instanceof LostConnection)) this.#keep(former);
    this.#use(former);
  }

  #ask(motions, changes = {}) {
    const { data, ...parameters } = this.#character;
    return moveCharacter(data, motions.map(({ npz }) => npz), { ...parameters, ...changes });
  }

  // Saves the selected motion, with the changes of the download panel.
  async save() {
    const { motion } = this.session;
    clearMessage();
    this.#update("The file is being made …");
    try {
      saveBlob(await this.#ask([motion], this.changes()), fileName(motion, "character", "glb"));
    } catch (error) {
      showMessage(error instanceof ServerError ? error.message : `This could not be done: ${error.message}`);
    } finally {
      this.#update("");
    }
  }

  #update(status) {
    find("character-name").textContent = this.#character?.name ?? "";
    find("remove-character").hidden = find("save-character").hidden = this.#character === null;
    find("save-character").disabled = status !== "" || this.session.motion === null;
    find("character-status").textContent = status;
  }
}

// Returns what the server needs of a character's file, and of a table of its bones that was chosen together with it.
async function readCharacter(files, most) {
  const table = files.find((file) => /\.ya?ml$/i.test(file.name));
  const file = files.find((one) => one !== table);
  if (!file) throw new ServerError(`${table.name}: is a table of joints; choose it together with its character`);
  if (!/\.(glb|vrm)$/i.test(file.name)) throw new ServerError(`${file.name}: is not a character; choose a .glb or .vrm file`);
  if (file.size > most) throw new ServerError(`${file.name}: has more than ${Math.round(most / 2 ** 20)} MB`);
  const rig = table ? { rig: await table.text(), rig_name: table.name } : {};
  return { data: await base64Of(file), name: file.name, ...rig };
}

function base64Of(file) {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    reader.onload = () => resolve(reader.result.split(",")[1] ?? "");
    reader.onerror = () => reject(reader.error);
    reader.readAsDataURL(file);
  });
}

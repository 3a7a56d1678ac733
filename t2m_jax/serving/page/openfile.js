// Motion files of the user's own, chosen with a button or dropped on the page.

import { clearMessage, clearNotice, find, showMessage, showNotice } from "./dom.js";
import { readMotion, ServerError } from "./server.js";
import { makeTake } from "./session.js";

export function listenForFiles(model, onOpen) {
  const input = find("file-input");
  const open = async (files) => {
    clearMessage();
    // A table of joints is chosen together with its motion file.
    const table = files.find(isTable);
    const motions = files.filter((one) => !isTable(one));
    for (const file of motions.length ? motions : [table]) {
      showNotice(`${file.name} is being opened …`);
      try {
        onOpen(await readTake(file, file === table ? undefined : table, model));
        clearNotice();
      } catch (error) {
        showMessage(error instanceof ServerError ? error.message : `${file.name}: ${error.message}`);
        return;
      }
    }
  };
  find("open-file").addEventListener("click", () => input.click());
  input.addEventListener("change", () => {
    if (input.files[0]) open([...input.files]);
    input.value = ""; // so that the same file can be opened again
  });
  listenForDrops(open);
}

const isTable = (file) => /\.ya?ml$/i.test(file.name);

async function readTake(file, table, model) {
  const formats = model.fields.scene.format.enum;
  const format = file.name.split(".").pop().toLowerCase();
  if (isTable(file)) throw new ServerError(`${file.name}: is a table of joints; open it together with its motion file`);
  if (!formats.includes(format)) throw new ServerError(`${file.name}: is not a motion file; open .${formats.join(", .")}`);
  if (file.size > model.body_bytes) {
    throw new ServerError(`${file.name}: has more than ${Math.round(model.body_bytes / 2 ** 20)} MB`);
  }
  const rig = table ? { rig: await table.text(), rig_name: table.name } : {};
  const { scene, motion } = await readMotion(await file.arrayBuffer(), { format, name: file.name, ...rig });
  return makeTake({ kind: "file", request: { seed: motion.seed, name: file.name }, scene, motions: [motion] });
}

function listenForDrops(open) {
  const hint = find("drop-hint");
  const hasFile = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragover", (event) => {
    if (!hasFile(event)) return;
    event.preventDefault();
    hint.hidden = false;
  });
  addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) hint.hidden = true;
  });
  addEventListener("drop", (event) => {
    if (!hasFile(event)) return;
    event.preventDefault();
    hint.hidden = true;
    open([...event.dataTransfer.files]);
  });
}

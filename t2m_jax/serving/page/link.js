// Links to motions: one for the selected motion, and what happens when somebody opens one.

import { find, showMessage, showNotice } from "./dom.js";
import { linkOf, recipeFromAddress, repeat } from "./recipe.js";

const LOOPBACK = ["localhost", "127.0.0.1", "[::1]"];

export function shareSelected({ take, selected }) {
  if (take === null) return;
  const link = linkOf(take, selected);
  if (link === null) {
    showNotice("Only motions that were made from sentences alone have a link. Download this one, and send the file.");
    return;
  }
  find("link").value = link;
  find("link-copied").textContent = "";
  find("link-hint").hidden = !LOOPBACK.includes(location.hostname);
  find("link-dialog").showModal();
  find("link").select();
}

export function listenForCopies() {
  find("copy-link").addEventListener("click", async () => {
    find("link").select();
    try {
      await navigator.clipboard.writeText(find("link").value);
      find("link-copied").textContent = "The link is copied.";
    } catch {
      find("link-copied").textContent = "Press Ctrl+C to copy it."; // without HTTPS, pages may not write to the clipboard
    }
  });
}

// Shows the motion of the link in the address, if there is one. It is made, unless the history has it.
export async function openLink({ generation, make, onDone, session, history }) {
  let recipe = null;
  try {
    recipe = recipeFromAddress();
    if (recipe === null) return;
    if (generation.isRunning) throw new Error("another motion is being made");
    make.fill(recipe.steps);
    const there = await history.findMade(recipe.steps);
    const take = there ?? (await repeat(recipe.steps, (...step) => generation.make(...step)));
    if (there !== null) session.show(there);
    else if (take !== null) await onDone({ ...take, steps: recipe.steps });
    if (take !== null) session.select(recipe.selected);
  } catch (error) {
    showMessage(`The link cannot be opened: ${error.message}.`);
  }
  // Only now, so that a page that is reloaded meanwhile begins again.
  if (!generation.isLeaving) window.history.replaceState(null, "", `${location.pathname}${location.search}`);
}

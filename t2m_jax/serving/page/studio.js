// Puts the parts of the page together.

import { CharacterPanel } from "./character.js";
import { compare, Comparison } from "./compare.js";
import { clearMessage, find, showMessage } from "./dom.js";
import { DownloadPanel } from "./download.js";
import { findField, plain } from "./fields.js";
import { Generation } from "./generation.js";
import { Handles } from "./handles.js";
import { History } from "./history.js";
import { listenForKeys } from "./keys.js";
import { listenForCopies, openLink, shareSelected } from "./link.js";
import { MakePanel } from "./make.js";
import { keepParts, recall, recallInTab, remember, rememberInTab } from "./memory.js";
import { listenForFiles } from "./openfile.js";
import { PathDrawing } from "./path.js";
import { Player } from "./player.js";
import { fetchModel, takeTokenFromAddress } from "./server.js";
import { changeSample } from "./recipe.js";
import { Session } from "./session.js";
import { TakeBar } from "./takebar.js";
import { TargetKeys } from "./targetkeys.js";
import { TargetPanel } from "./targetpanel.js";
import { Targets } from "./targets.js";
import { Timeline } from "./timeline.js";
import { UndoStack } from "./undo.js";
import { showWords } from "./words.js";

async function start() {
  takeTokenFromAddress();
  const model = await fetchModel();
  find("model-name").textContent = model.name;
  find("about").textContent = `Model: ${model.name}, ${model.license}`;

  const session = new Session();
  const undo = new UndoStack();
  const stage = new T2M.Stage(find("stage"));
  const player = new Player(stage, session);
  const timeline = new Timeline(stage, session, player, {
    step: model.downsample / model.fps,
    longest: plain(model.fields.motions.seconds).maximum,
    onResize: (part, length) => make.resize(part, length),
  });
  const comparison = new Comparison(session, stage);
  const history = new History(session, undo, async (entry) => comparison.choose(await history.take(entry.id)));
  const make = new MakePanel(session, model, undo, { player, generate: (request, kind, base) => generation.run(request, kind, base) });
  const targets = new Targets(findField("targets"), session, undo);
  const targetPanel = new TargetPanel(targets, model, { stage, player, session });
  const handles = new Handles(targets, targetPanel, { stage, player, session });
  new TargetKeys(targets, targetPanel, timeline);
  const addTake = (take, draft) => add(take, draft, { session, history, make, undo });
  const generation = new Generation({ session, stage, onDone: (take) => addTake(take, make.forgetDraft(take.kind, take.request.captions)) });
  const actions = {
    rename: () => withEntry((entry) => history.rename(entry)),
    duplicate: () => withEntry(async (entry) => session.show(await history.duplicate(entry))),
    delete: () => withEntry((entry) => history.delete([entry.id], "delete")),
    share: () => shareSelected(session),
    split: () => session.motion && changeSample(session.take, session.selected, { split: player.time }).then(addTake).catch(complain),
  };
  const withEntry = (action) => {
    const { take } = session;
    const entry = history.find(take?.id);
    if (entry) return action(entry).catch(complain);
    // Another tab may have deleted it. A comparison never is in the history.
    if (take && take.kind !== "comparison") complain(new Error("this motion is no longer in the history"));
  };
  new TakeBar(session, history, { ...actions, onReuseSeed: (seed) => make.reuseSeed(seed), onKeep: addTake });
  const download = new DownloadPanel(session, model, addTake);
  const character = new CharacterPanel(session, model, stage, () => download.changes());
  const drawing = new PathDrawing({ stage, player, session, onDrawn: () => download.apply() });
  showWords(model, (word) => make.sentences.insert(word));
  listenForFiles(model, addTake);
  listenForCopies();
  listenForKeys({ player, timeline, session, stage, make, generation, comparison, undo, drawing, actions });
  find("then").addEventListener("click", () => make.continueMotion());
  find("split").addEventListener("click", actions.split);
  find("replace-sentence").addEventListener("click", () => make.replaceSentence());
  find("help-button").addEventListener("click", () => find("help").showModal());
  session.onChange(["take"], clearMessage);
  stage.onchange = () => {
    player.update();
    timeline.update();
    handles.update();
  };
  await history.open();
  await showFormer(session, history, player).catch(complain);
  download.resume();
  await comparison.resume(history).catch(complain);
  character.resume(history.store).catch(complain);
  keepParts();
  make.resume();
  const followLink = () => openLink({ generation, make, session, history, onDone: addTake });
  addEventListener("hashchange", followLink);
  await followLink();
  await generation.resume();
}

const complain = (error) => showMessage(`This cannot be done: ${error.message.replace(/\.$/, "")}.`);

// Adds a new take to the history and shows it; undone, what was there before comes back.
function add(take, draft, { session, history, make, undo }) {
  const former = { take: session.take, selected: session.selected, span: session.span };
  const stored = history.add(take);
  session.show(take);
  undo.dropDrafts();
  undo.push({
    name: "new motion",
    undo: async () => {
      await history.change([take.id], { deleted: Date.now() });
      if (session.take === take) {
        session.show(former.take, former.selected);
        session.setSpan(former.span);
      }
      if (draft) make.setDraft(take.kind, draft);
    },
    redo: async () => {
      await history.change([take.id], { deleted: null });
      if (draft) make.forgetDraft(take.kind, take.request.captions);
      session.show(take);
    },
  });
  return stored;
}

// Shows what was shown when the page was left, and keeps what that is.
async function showFormer(session, history, player) {
  const former = recall("selection");
  const time = recallInTab("time");
  session.onChange(["take", "select", "span"], () => {
    const { take, selected, span } = session;
    if (take?.compared || history.find(take?.id)) remember("selection", { id: take.id, compared: take.compared, selected, span });
  });
  addEventListener("pagehide", () => rememberInTab("time", player.time));
  const take = await formerTake(former ?? {}, history).catch(() => null);
  if (take !== null) {
    session.show(take, former.selected);
    session.setSpan(former.span);
    player.stage.time = time ?? 0;
  } else if (history.newest) session.show(await history.take(history.newest.id));
}

// Returns null if it, or one of two that were compared, is no longer in the history.
async function formerTake({ id, compared }, history) {
  const wanted = compared ?? [{ id }];
  if (!wanted.every((one) => history.find(one.id))) return null;
  const takes = await Promise.all(wanted.map((one) => history.take(one.id)));
  return compared ? compare(compared.map(({ number }, place) => ({ take: takes[place], number }))) : takes[0];
}

start().catch((error) => showMessage(`The studio cannot start: ${error.message}`));

// Puts the parts of the page together.

import { Comparison } from "./compare.js";
import { clearMessage, find, showMessage } from "./dom.js";
import { DownloadPanel } from "./download.js";
import { Generation } from "./generation.js";
import { History } from "./history.js";
import { listenForKeys } from "./keys.js";
import { MakePanel } from "./make.js";
import { listenForFiles } from "./openfile.js";
import { Player } from "./player.js";
import { fetchModel, takeTokenFromAddress } from "./server.js";
import { Session } from "./session.js";
import { TakeBar } from "./takebar.js";
import { Timeline } from "./timeline.js";
import { showWords } from "./words.js";

async function start() {
  takeTokenFromAddress();
  const model = await fetchModel();
  find("model-name").textContent = model.name;
  find("about").textContent = `Model: ${model.name}, ${model.license}`;

  const session = new Session();
  const stage = new T2M.Stage(find("stage"));
  const player = new Player(stage, session);
  const timeline = new Timeline(stage, session, player);
  const comparison = new Comparison(session);
  const history = new History(session, async (entry) => comparison.choose(await history.take(entry.id)));
  const showNew = (take) => {
    session.show(take);
    history.add(take);
  };
  const generation = new Generation({ session, stage, model, onDone: (take) => {
    make.forgetDraft(take.kind);
    showNew(take);
  } });
  const make = new MakePanel(session, model, (request, kind) => generation.run(request, kind));
  new TakeBar(session, { onReuseSeed: (seed) => make.reuseSeed(seed), onKeep: showNew });
  new DownloadPanel(session, model, showNew);
  showWords(model, (word) => make.sentences.insert(word));
  listenForFiles(model, showNew);
  listenForKeys({ player, timeline, session, stage, make, generation, comparison });
  find("then").addEventListener("click", () => make.continueMotion());
  find("help-button").addEventListener("click", () => find("help").showModal());
  session.onChange(["take"], clearMessage);
  stage.onchange = () => {
    player.update();
    timeline.update();
  };
  await history.open();
}

start().catch((error) => showMessage(`The studio cannot start: ${error.message}`));

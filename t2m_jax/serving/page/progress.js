// How much of a motion is made, and how long the rest takes.

const SHOWN_AFTER = 2; // seconds; what is over sooner needs no words
const NEW_WEIGHT = 0.5; // of the newest estimate of the end, as the server tells shares in jumps
const BURST = 0.3; // seconds in which a page that was reloaded gets what was told before, which says nothing about time

export class Progress {
  constructor(bar, text) {
    Object.assign(this, { bar, text });
  }

  show() {
    this.bar.hidden = false;
    this.start();
    this.timer = setInterval(() => this.#tell(), 500);
  }

  hide() {
    clearInterval(this.timer);
    this.bar.hidden = true;
    this.text.textContent = "";
  }

  // The work begins, perhaps anew.
  start() {
    const begin = performance.now() / 1000;
    Object.assign(this, { begin, end: null, base: { share: 0, time: begin } });
    this.bar.removeAttribute("aria-valuenow"); // the share is not known
    this.bar.style.removeProperty("--share");
    this.#tell();
  }

  set(share) {
    const now = performance.now() / 1000;
    if (now - this.begin < BURST) this.base = { share, time: now };
    else if (share > this.base.share) {
      const end = now + ((1 - share) * (now - this.base.time)) / (share - this.base.share);
      this.end = this.end === null ? end : this.end + NEW_WEIGHT * (end - this.end);
    }
    this.bar.setAttribute("aria-valuenow", Math.round(100 * share));
    this.bar.style.setProperty("--share", share);
    this.#tell();
  }

  #tell() {
    const now = performance.now() / 1000;
    const share = this.bar.getAttribute("aria-valuenow");
    if (now - this.begin < SHOWN_AFTER) this.text.textContent = "";
    else if (this.end === null && share) this.text.textContent = `${share} % done`;
    else if (this.end === null) this.text.textContent = `${Math.floor(now - this.begin)} s so far`;
    else this.text.textContent = `${share} % done, about ${Math.max(Math.ceil(this.end - now), 1)} s left`;
  }
}

// What the page shows now. A "take" is the result of one request: the same sentences, one or more motions (samples).

export class Session extends EventTarget {
  take = null;
  selected = 0;
  span = null;

  get motion() {
    return this.take?.motions[this.selected] ?? null;
  }

  // Sends "take" to all panels. Their parts of the page are then as if no take was shown before.
  show(take, selected = 0) {
    Object.assign(this, { take, selected, span: null });
    this.dispatchEvent(new Event("take"));
  }

  select(number) {
    if (number === this.selected || !this.take?.motions[number]) return;
    this.selected = number;
    this.dispatchEvent(new Event("select"));
  }

  setSpan(span) {
    this.span = span;
    this.dispatchEvent(new Event("span"));
  }

  onChange(names, action) {
    for (const name of names) this.addEventListener(name, action);
  }
}

// `steps` say how it was made (see recipe.js); null if nobody can make it again.
export function makeTake({ id, kind, request, scene, motions, warning = "", steps = null }) {
  const created = Date.now();
  return { id: id ?? `${created}-${Math.random()}`, created, kind, request, scene, motions, warning, steps };
}

// The sentences that a motion shows one after the other.
export function sentencesOf(motion) {
  return motion.part_captions.length ? motion.part_captions : [motion.caption];
}

// Its sentences with the seconds in which each begins and ends: {caption, span}.
export function partsOf(motion) {
  const starts = motion.part_starts.length ? motion.part_starts : [0];
  const edges = [...starts, motion.frames].map((frame) => frame / motion.fps);
  return sentencesOf(motion).map((caption, place) => ({ caption, span: [edges[place], edges[place + 1]] }));
}

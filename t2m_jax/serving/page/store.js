// Takes in the browser's IndexedDB: short entries for the list, and apart from them the motions, which are large. The user's
// own character is kept with the motions.

const NAME = "t2m-studio";
const VERSION = 2; // of what a take has; takes of another version cannot be shown, and are deleted
const CHARACTER = "character"; // no take has this id

function settled(request) {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

function committed(transaction) {
  return new Promise((resolve, reject) => {
    transaction.oncomplete = () => resolve();
    transaction.onabort = () => reject(transaction.error);
  });
}

export class Store {
  static async open() {
    const request = indexedDB.open(NAME, VERSION);
    request.onupgradeneeded = () => {
      for (const name of [...request.result.objectStoreNames]) request.result.deleteObjectStore(name);
      request.result.createObjectStore("entries", { keyPath: "id" });
      request.result.createObjectStore("takes", { keyPath: "id" });
    };
    const store = new Store();
    store.database = await settled(request);
    return store;
  }

  #write(action) {
    const transaction = this.database.transaction(["entries", "takes"], "readwrite");
    action(transaction.objectStore("entries"), transaction.objectStore("takes"));
    return committed(transaction);
  }

  entries() {
    return settled(this.database.transaction("entries").objectStore("entries").getAll());
  }

  take(id) {
    return settled(this.database.transaction("takes").objectStore("takes").get(id));
  }

  has(id) {
    return settled(this.database.transaction("takes").objectStore("takes").count(id)); // which does not read the motion
  }

  character() {
    return this.take(CHARACTER);
  }

  // Keeps a character in place of the one before; null keeps none.
  setCharacter(character) {
    return this.#write((_, takes) => (character ? takes.put({ ...character, id: CHARACTER }) : takes.delete(CHARACTER)));
  }

  add(entry, take) {
    return this.#write((entries, takes) => [entries.put(entry), takes.put(take)]);
  }

  change(changed) {
    return this.#write((entries) => changed.map((entry) => entries.put(entry)));
  }

  delete(unwanted) {
    return this.#write((entries, takes) => unwanted.map(({ id }) => [entries.delete(id), takes.delete(id)]));
  }
}

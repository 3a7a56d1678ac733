// A classic script in the head: the colors must be known before the first picture of the page.
(() => {
  "use strict";
  const KEY = "t2m-theme";
  const root = document.documentElement;

  function apply(theme) {
    if (theme === "auto") delete root.dataset.theme;
    else root.dataset.theme = theme;
  }

  function stored() {
    try {
      return localStorage.getItem(KEY) ?? "auto";
    } catch {
      return "auto"; // storage is forbidden here
    }
  }

  apply(stored());
  document.addEventListener("DOMContentLoaded", () => {
    const choice = document.getElementById("theme");
    choice.value = stored();
    choice.addEventListener("change", () => {
      apply(choice.value);
      try {
        localStorage.setItem(KEY, choice.value);
      } catch {
        // The choice is kept until the page is closed.
      }
    });
  });
})();

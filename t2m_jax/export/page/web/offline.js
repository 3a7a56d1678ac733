// The service worker, which keeps the files and isolates the page.

const RELOADED = `t2m-page-reloaded ${location.pathname}`;
const PATIENCE = 10_000; // milliseconds; without a service worker the page works while its server does

const controlled = () => new Promise((resolve) => {
  navigator.serviceWorker.addEventListener("controllerchange", resolve, { once: true });
  setTimeout(resolve, PATIENCE);
});

// Resolves when the page can begin; it may be loaded once more before, as only then it may use several threads.
export async function prepareOffline() {
  if (!isSecureContext) throw new Error("it needs an address with https:// or localhost");
  if (!("serviceWorker" in navigator)) return;
  try {
    await navigator.serviceWorker.register("sw.js");
  } catch {
    return; // private windows of some browsers have none
  }
  if (!navigator.serviceWorker.controller) await controlled();
  if (crossOriginIsolated || !navigator.serviceWorker.controller || sessionStorage.getItem(RELOADED)) return;
  sessionStorage.setItem(RELOADED, "yes");
  location.reload();
  await new Promise(() => {});
}

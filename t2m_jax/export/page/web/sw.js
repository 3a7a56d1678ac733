// Keeps all files of the page, so that it works without a network after the first visit, and adds headers that a plain file
// server does not send: only an isolated page may use several threads, and a worker has a policy of its own.

const VERSION = "{{version}}"; // of all files together: other files are another cache
const SHELL = {{shell}}; // needed at once; the model comes when the page asks for it
const PREFIX = `t2m-page ${registration.scope} `;
const HEADERS = {
  "Content-Security-Policy": "{{policy}}",
  "Cross-Origin-Opener-Policy": "same-origin",
  "Cross-Origin-Embedder-Policy": "require-corp",
  "Cross-Origin-Resource-Policy": "same-origin",
  "X-Content-Type-Options": "nosniff",
  "Referrer-Policy": "no-referrer",
};

addEventListener("install", (event) => {
  const fill = async () => (await caches.open(PREFIX + VERSION)).addAll(SHELL.map((name) => new Request(name, { cache: "no-cache" })));
  event.waitUntil(fill().then(() => skipWaiting()));
});

addEventListener("activate", (event) => {
  const forget = async () => {
    const old = (await caches.keys()).filter((name) => name.startsWith(PREFIX) && name !== PREFIX + VERSION);
    await Promise.all(old.map((name) => caches.delete(name)));
    await clients.claim();
  };
  event.waitUntil(forget());
});

async function answer(event) {
  const { request } = event;
  const cache = await caches.open(PREFIX + VERSION);
  const isWrong = request.cache === "reload"; // the page says so, or the user does
  const known = isWrong ? undefined : await cache.match(request, { ignoreSearch: request.mode === "navigate" });
  // A file of an older export may be in the browser's own cache; a navigation cannot say how it is fetched.
  const response = known ?? (await fetch(request, request.mode === "navigate" ? {} : { cache: "no-cache" }));
  if (!response.ok) return response;
  if (!known) event.waitUntil(cache.put(request, response.clone()).catch(() => {})); // without room, the file is only used now
  const headers = new Headers(response.headers);
  for (const [name, value] of Object.entries(HEADERS)) headers.set(name, value);
  return new Response(response.body, { status: response.status, headers });
}

addEventListener("fetch", (event) => {
  const { request } = event;
  if (request.method === "GET" && request.url.startsWith(registration.scope)) event.respondWith(answer(event));
});

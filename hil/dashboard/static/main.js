// The page: a stream of facts from the server, and the night (or the nights) that they are about.

import { Asking } from "./ask.js";
import { Detail } from "./detail.js";
import { address, showCards } from "./overview.js";
import { troubleOf } from "./state.js";
import { Store } from "./store.js";
import { Stream } from "./stream.js";
import { age, time } from "./words.js";

const $ = (id) => document.getElementById(id);
const store = new Store();
let connected = false;
let silentMs = 0;

const stream = new Stream({ onFrame: take, onLink: link, onRefused: unlock });
const asking = new Asking(stream, say);
const detail = new Detail((night, kind, prompt) => asking.open(night, kind, prompt));

function take(frame) {
  const began = performance.now();
  const changed = store.take(frame);
  show(changed);
  performance.clearMeasures("hil-update");
  performance.measure("hil-update", { start: began, end: performance.now() });
}

// The night that is chosen: by the address, or because there is no other.
function chosen() {
  for (const id of store.nights.keys()) if (address(id) === location.hash) return id;
  return store.nights.size === 1 ? [...store.nights.keys()][0] : null;
}

function show(changed) {
  const id = chosen();
  const night = id === null ? null : store.nights.get(id);
  $("empty").hidden = store.nights.size > 0 || store.utc === null;
  $("overview").hidden = id !== null || store.nights.size === 0;
  $("night").hidden = id === null || night.head.state === "unreadable";
  $("not-shown").hidden = !store.notShown;
  $("not-shown").textContent = `${store.notShown} older nights of this folder are not shown; hil dashboard with a night's own folder shows it.`;
  const name = night ? night.head.title : store.nights.size ? `${store.folder}: ${store.nights.size} nights` : store.folder;
  if ($("title").textContent !== name) $("title").textContent = name;
  document.title = night ? `${night.head.step || night.head.state} · ${name}` : `${name} · hil`;
  if (night) {
    if (changed === null || changed.has(id) || detail.id !== id) detail.show(id, night, changed && changed.get(id));
  } else if (changed === null || changed.size) {
    showCards($("cards"), store.nights);
    detail.id = null;
  }
  banner(night);
}

function banner(night) {
  const trouble = connected ? night && troubleOf(night.head) : lost();
  const text = trouble ? trouble.text : "";
  if ($("banner").textContent !== text) $("banner").textContent = text;
  $("banner").className = `banner ${trouble && trouble.bad ? "bad" : ""}`;
  $("banner").hidden = !trouble;
}

function lost() {
  if (store.utc === null && silentMs < 3000) return null;
  const since = store.utc === null ? "" : ` What is below is from ${time(store.utc)}.`;
  return { bad: true, text: `No connection to the dashboard for ${age(silentMs / 1000)}; trying again.${since}` };
}

function link(now, silent) {
  silentMs = silent;
  if (now === connected && now) return;
  connected = now;
  $("link").textContent = now ? "live" : "no connection";
  $("link").className = `link ${now ? "live" : "lost"}`;
  banner(detail.id === null ? null : store.nights.get(detail.id));
}

function unlock() {
  $("unlock-error").hidden = !stream.token;
  $("unlock-token").value = "";
  if (!$("unlock").open) $("unlock").showModal();
}

$("unlock-form").addEventListener("submit", (event) => {
  event.preventDefault();
  $("unlock").close();
  stream.unlock($("unlock-token").value.trim());
});
$("unlock").addEventListener("cancel", (event) => event.preventDefault());

let toastEnds;
function say(text) {
  $("toast").textContent = text;
  $("toast").hidden = false;
  clearTimeout(toastEnds);
  toastEnds = setTimeout(() => ($("toast").hidden = true), 6000);
}

window.addEventListener("hashchange", () => show(null));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => detail.restyle());
stream.run();

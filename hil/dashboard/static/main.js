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
let broken = "";

const stream = new Stream({ onFrame: take, onLink: link, onRefused: unlock });
const asking = new Asking(stream, say);
const detail = new Detail((night, kind, prompt) => asking.open(night, kind, prompt));

function take(frame) {
  const began = performance.now();
  try {
    show(store.take(frame));
    broken = "";
  } catch (error) {
    broken = String(error); // which is not the connection's fault, and must not look as if it were
    banner(null);
    console.error(error);
  }
  performance.clearMeasures("hil-update");
  performance.measure("hil-update", { start: began, end: performance.now() });
}

// The night that is chosen: by the address, or where that names none, because there is no other.
function chosen() {
  for (const id of store.nights.keys()) if (address(id) === location.hash) return id;
  return store.nights.size === 1 && location.hash.length < 2 ? [...store.nights.keys()][0] : null;
}

function show(changed) {
  const id = chosen();
  const night = id === null ? null : store.nights.get(id);
  $("empty").hidden = store.nights.size > 0 || store.utc === null;
  $("overview").hidden = id !== null || store.nights.size === 0;
  $("night").hidden = id === null || night.head.state === "unreadable";
  $("not-shown").hidden = !store.notShown;
  $("units").hidden = !store.units;
  if (store.units) $("units").href = store.units;
  $("not-shown").textContent = `${store.notShown} older nights of this folder are not shown; hil dashboard with a night's own folder shows it.`;
  const nights = [...store.nights.keys()].filter((each) => !`/${each}`.includes("/units/")).length; // a unit of one is none
  const counted = `${nights} ${nights === 1 ? "night" : "nights"}`;
  const name = night ? night.head.title : nights ? `${store.folder}: ${counted}` : store.folder;
  if ($("title").textContent !== name) $("title").textContent = name;
  const asks = (each) => (each.head.prompt ? `asks: ${each.head.prompt.question}` : "");
  const many = [...store.nights.values()].some(asks) ? `asks · ${name}` : `${name} · hil`;
  document.title = night ? `${asks(night) || night.head.step || night.head.state} · ${name}` : many;
  if (night) {
    if (changed === null || changed.has(id) || detail.id !== id) detail.show(id, night, changed && changed.get(id), store.reports);
  } else if (changed === null || changed.size) {
    showCards($("cards"), store.nights, store.reports);
    detail.id = null;
  }
  banner(night);
}

// What is wrong: with the connection, with this page, with the folder, with the night; the first of them is said.
function trouble(night) {
  if (!connected) return lost();
  if (broken) return { bad: true, text: `This page has failed (${broken}). Load it again; what is below may be old.` };
  if (store.problem) return { bad: true, text: `The folder of the nights cannot be looked at: ${store.problem}. What is below is old.` };
  return night && troubleOf(night.head);
}

function banner(night) {
  const found = trouble(night);
  const text = found ? found.text : "";
  if ($("banner").textContent !== text) $("banner").textContent = text;
  $("banner").className = `banner ${found && found.bad ? "bad" : ""}`;
  $("banner").hidden = !found;
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

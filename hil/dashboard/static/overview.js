// Several nights on one screen: one card each, and the whole night behind it.

import { capital, dateTime, dayTime, degrees, duration, sentence } from "./words.js";
import { identityOf, reportLink, stateOf, troubleOf } from "./state.js";

const text = (tag, className, content) => {
  const element = document.createElement(tag);
  element.className = className;
  element.textContent = content;
  return element;
};

export function address(id) {
  return `#${encodeURIComponent(id)}`;
}

export function showCards(list, nights, reports) {
  const cards = [...nights].map(([id, night]) => card(id, night.head, reports));
  const focused = list.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
  cards.forEach((made, i) => {
    const before = list.children[i];
    if (!before) list.append(made);
    else if (!before.isEqualNode(made)) before.replaceWith(made); // what says the same stays: it may be about to be pressed
  });
  while (list.children.length > cards.length) list.lastChild.remove();
  if (focused) [...list.querySelectorAll("a")].find((link) => link.getAttribute("href") === focused)?.focus();
}

function card(id, head, reports) {
  const link = document.createElement("a");
  link.href = address(id);
  link.className = "card";
  const [word, className] = stateOf(head);
  const badges = text("span", "", "");
  badges.append(text("span", `badge ${className}`, word));
  if (head.simulated) badges.append(" ", text("span", "badge simulated", "SIMULATED"));
  link.append(text("span", "where", head.bench && head.bench !== id ? `${head.bench} · ${id}` : id), badges);
  const trouble = troubleOf(head);
  if (trouble && trouble.bad) link.className = "card bad";
  if (head.verdict && !word.includes(head.verdict.verdict)) badges.append(" ", text("span", `verdict ${head.verdict.verdict}`, head.verdict.verdict));
  const what = capital(sentence(head.step || (trouble ? "" : head.reason || head.title)));
  if (what) link.append(text("span", "what", what));
  if (trouble) link.append(text("span", "trouble", trouble.text));
  if (head.to_do && head.to_do !== "nothing") link.append(text("span", "to-do", `To do: ${head.to_do}`));
  if (head.prompt) link.append(text("span", "asks", `Asks: ${head.prompt.question}`));
  for (const line of head.over || []) link.append(text("span", "small", `Over: ${sentence(line)}`));
  link.append(text("span", "small", facts(head)));
  const began = head.began_utc ? `began ${dateTime(head.began_utc)}` : "";
  link.append(text("span", "small", [identityOf(head), began].filter(Boolean).join(" · ")));
  const item = document.createElement("li");
  item.append(link);
  const report = reportLink(id, head, reports);
  if (report) item.append(report);
  return item;
}

function facts(head) {
  const found = [];
  if (head.now) found.push(`chamber ${degrees(head.now.chamber_degC)} °C`);
  if (head.steps_total) found.push(`${head.self_calibrations_done} of ${head.self_calibrations_total} self-calibrations`);
  if (head.now && head.now.step_remaining_s) found.push(`step ${duration(head.now.step_remaining_s)} to go`);
  if (head.finishing_utc) found.push(`finishing ${dayTime(head.finishing_utc)}`);
  return found.join(", ");
}

// The self-calibrations so far: one line for each sensor, with its parameters ± one standard deviation, as hil solve has them.

import { degrees, sentence, withError } from "./words.js";

function cell(tag, className, content) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.textContent = content;
  return made;
}

// Return what there is to show: the table, and below it in words what is not as it should be.
export function results(rows, { working, units }) {
  if (!rows.length) return [cell("p", "small", "No self-calibration has begun yet.")];
  const list = cell("ul", "small reasons", "");
  for (const row of rows) {
    for (const each of row.collects) {
      if (each.verdict && each.verdict !== "PASS") list.append(reason(row, `collect ${each.position}`, each));
    }
    for (const each of row.solutions) {
      if (each.verdict !== "PASS") list.append(reason(row, `sensor ${each.sensor}`, each));
    }
  }
  const assumed = new Set(rows.flatMap((row) => row.solutions.flatMap((each) => each.assumed)));
  for (const each of assumed) list.append(cell("li", "", `Assumed: ${sentence(each)}`));
  const about = units.length
    ? "Each unit is solved by itself: its parameters stand on its own page."
    : "Value ± one standard deviation, what repeats so far show included: the ± of hil solve.";
  return [table(rows, working, units), cell("p", "small", about), list];
}

function reason(row, what, { verdict, reason }) {
  return cell("li", "", `Run ${row.number}, ${what}: ${verdict}: ${sentence(reason)}`);
}

function table(rows, working, units) {
  const names = [...new Set(rows.flatMap((row) => row.solutions.flatMap((each) => Object.keys(each.parameters))))];
  const made = document.createElement("table");
  const head = made.createTHead().insertRow();
  const measuredIn = unitsOf(rows);
  head.append(heading("Run", "left"), heading("°C", ""), heading("Collects", "left"), heading("Sensor", ""));
  head.append(heading("Verdict", "left"));
  for (const name of names) head.append(heading(name, "", measuredIn.get(name)));
  const body = made.createTBody();
  for (const row of [...rows].reverse()) addRow(body, row, names, working, units);
  return made;
}

function heading(text, className, unit = "") {
  const made = cell("th", className, text);
  made.scope = "col";
  if (unit) made.append(document.createElement("br"), cell("span", "unit", unit));
  return made;
}

function unitsOf(rows) {
  const units = new Map();
  for (const row of rows) {
    for (const each of row.solutions) {
      for (const [name, estimate] of Object.entries(each.parameters)) units.set(name, estimate.unit);
    }
  }
  return units;
}

function addRow(body, row, names, working, units) {
  const lines = row.solutions.length ? row.solutions : [null];
  lines.forEach((solution, i) => {
    const line = body.insertRow();
    if (i === 0) line.append(...firstCells(row, lines.length));
    line.append(labelled("Sensor", cell("td", "", solution ? String(solution.sensor) : "")), verdictCell(solution, row, working, units));
    for (const name of names) line.append(labelled(name, parameter(solution && solution.parameters[name])));
  });
}

// What stands over a column stands before its cell where the screen is too narrow for columns.
function labelled(name, made) {
  made.dataset.name = name;
  return made;
}

function firstCells(row, span) {
  const number = cell("th", "", String(row.number));
  number.scope = "row";
  const collects = cell("td", "left", "");
  for (const each of row.collects) {
    const mark = cell("span", `verdict ${each.verdict || "todo"}`, each.position);
    mark.title = each.verdict ? `${each.verdict}: ${each.reason}` : "to do";
    collects.append(mark, " ");
  }
  const cells = [labelled("Run", number), labelled("°C", cell("td", "", degrees(row.temperature_degC))), labelled("Collects", collects)];
  for (const each of cells) each.rowSpan = span;
  return cells;
}

function parameter(estimate) {
  if (!estimate || estimate.value === null) return cell("td", "", estimate ? "not seen" : "");
  const [value, error] = withError(estimate.value, estimate.sd);
  const made = cell("td", "", `${value} `);
  made.append(cell("span", "se", error), cell("span", "unit narrow", ` ${estimate.unit}`));
  return made;
}

function verdictCell(solution, row, working, units) {
  const made = cell("td", "left", "");
  if (!solution) {
    made.textContent = row.done ? (units.length ? "unit by unit" : "not solved") : working ? "going on" : "not finished";
    return made;
  }
  const mark = cell("span", `verdict ${solution.verdict}`, solution.verdict);
  mark.title = solution.reason;
  made.append(mark);
  return made;
}

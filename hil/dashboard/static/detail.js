// One night: every part of it has a place of its own on the page, and is written only where it changed.

import { AverageChart, TemperatureChart, temperatureStyle } from "./charts.js";
import { results } from "./results.js";
import { identityOf, reportLink, stateOf } from "./state.js";
import { points } from "./store.js";
import { capital, channelName, countdown, dateTime, dayTime, degrees, duration, temperatureName, sentence, signed, time, withError, zone } from "./words.js";

const $ = (id) => document.getElementById(id);
const put = (id, text) => {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
};

export class Detail {
  constructor(onAsk) {
    this.id = null;
    this.night = null;
    this.temperatures = new TemperatureChart($("temperature-chart"), (text) => put("temperature-told", text || this.hint()));
    this.channels = new Map();
    for (const kind of ["pause", "continue", "abort", "confirm", "refuse"]) {
      $(kind).addEventListener("click", () => {
        const prompt = kind === "confirm" || kind === "refuse" ? this.night.head.prompt : null;
        onAsk(this.id, kind, prompt);
      });
    }
  }

  hint() {
    return `Clock times are ${zone()}. Touch the curves, or point at them, for their values.`;
  }

  restyle() {
    this.temperatures.restyle();
    for (const channel of this.channels.values()) channel.chart.restyle();
    if (this.night) this.show(this.id, this.night, null);
  }

  // Show a night; `changed` names the parts to write anew, null all of them.
  show(id, night, changed, reports = this.reports) {
    this.reports = reports;
    const all = changed === null || id !== this.id;
    if (id !== this.id) this.makeChannels([]); // the curves in them are another night's
    this.id = id;
    this.night = night;
    if (!night.head || night.head.state === "unreadable") return;
    const has = (part) => all || changed.has(part);
    if (has("head")) this.showHead(night.head);
    if (has("temperatures") || has("plan")) this.showTemperatures(night);
    if (has("head") || has("collect")) this.showRates(night);
    if (has("results") || this.working !== night.head.working) {
      $("results").replaceChildren(...results(night.results || [], night.head));
      this.working = night.head.working;
    }
    if (has("events")) this.showEvents(night.events || []);
  }

  showHead(head) {
    const [word, className] = stateOf(head);
    put("state", word);
    $("state").className = `badge ${className}`;
    $("simulated").hidden = !head.simulated;
    put("step", capital(sentence(head.step || ending(head))));
    put("note", noteOf(head));
    this.showClocks(head);
    const calibrations = `${head.self_calibrations_done} of ${head.self_calibrations_total} self-calibrations`;
    put("done", `${head.steps_done} of ${head.steps_total} steps done, ${calibrations}`);
    $("progress").max = Math.max(head.steps_total, 1);
    $("progress").value = head.steps_done;
    put("about", [head.bench && `bench ${head.bench}`, identityOf(head), `began ${dateTime(head.began_utc)}`].filter(Boolean).join(" · "));
    const why = head.verdict && head.verdict.verdict !== "ERROR" ? `: ${sentence(head.verdict.reason)}` : ""; // the line at the top says that
    put("verdict", head.verdict ? `${head.verdict.verdict}${why}` : "");
    $("verdict").className = `verdict ${head.verdict ? head.verdict.verdict : ""}`;
    const unit = head.in_spec;
    put("in-spec", unit ? `${capital(unit.verdict)}: ${sentence(unit.reason)}` : "");
    $("in-spec").className = unit ? `verdict ${{ "in spec": "PASS", "out of spec": "FAIL" }[unit.verdict] || "INCONCLUSIVE"}` : "";
    put("to-do", `To do: ${head.to_do}`);
    put("chamber", head.problems.includes(head.chamber_in_words) ? "" : sentence(head.chamber_in_words));
    put("over", (head.over || []).map((line) => `Over: ${sentence(line)}`).join(" · "));
    const report = reportLink(this.id, head, this.reports);
    $("report").replaceChildren(...(report ? [report] : head.working ? [] : [`hil report makes the report of this night.`]));
    this.showPrompt(head);
    $("controls").hidden = !head.working;
    $("pause").hidden = head.state === "paused";
    $("pause").disabled = Boolean(head.pausing);
    $("continue").hidden = head.state !== "paused";
    for (const card of ["rates-card", "stream-card"]) $(card).hidden = !head.working;
    put("results-title", head.working ? "Results so far" : "Results");
    this.showMissing(head);
    this.showStream(head);
  }

  showClocks(head) {
    const now = head.now;
    const over = now && now.step_remaining_s <= 0;
    $("remaining-clock").hidden = !now;
    put("remaining-label", over ? "Step, longer than planned" : "Step, to go");
    put("remaining", now ? countdown(over ? now.step_elapsed_s : now.step_remaining_s) : "–");
    put("finishing-label", head.working ? "Finishing" : head.state === "complete" ? "Finished" : head.killed ? "Last seen" : "Ended");
    const end = head.working ? head.finishing_utc : head.last_utc;
    put("finishing", end ? dayTime(end) : "–");
    const elapsed = now ? Date.parse(head.began_utc) + 1000 * now.elapsed_s : null;
    put("finishing-in", head.working && end && elapsed ? `in ${duration((Date.parse(end) - elapsed) / 1000)}` : "");
  }

  showPrompt(head) {
    $("prompt").hidden = !head.prompt;
    if (!head.prompt) return;
    put("question", head.prompt.question);
    put("prompt-until", `asked ${dayTime(head.prompt.since_utc)}, waits until ${dayTime(head.prompt.until_utc)}`);
  }

  showMissing(head) {
    const missing = head.missing || [];
    $("missing-card").hidden = !missing.length;
    if (missing.join("\n") !== this.missing) $("missing").replaceChildren(...missing.map((line) => item(sentence(line))));
    this.missing = missing.join("\n");
  }

  showStream(head) {
    const stream = head.now && head.now.stream;
    $("stream").className = `health ${stream ? "" : "none"}`;
    if (!stream) {
      put("stream", "No stream is being read");
      put("stream-counts", "");
      return;
    }
    const good = stream.lost + stream.damaged + stream.unread_bytes === 0;
    const slow = stream.hz !== null && stream.nominal_hz && stream.hz < 0.9 * stream.nominal_hz;
    $("stream").classList.toggle("bad", !good || slow);
    put("stream", slow ? "Samples are missing now" : good ? "Every frame arrived" : "Frames were lost or damaged");
    const rate = stream.hz === null || stream.nominal_hz === null ? "" : `${stream.hz.toFixed(0)} of ${stream.nominal_hz.toFixed(0)} samples/s; `;
    const unread = stream.unread_bytes ? `, ${stream.unread_bytes} bytes unread` : "";
    put("stream-counts", `${rate}${stream.ok.toLocaleString("en-GB")} good frames, ${stream.lost} lost, ${stream.damaged} damaged${unread}`);
  }

  showTemperatures(night) {
    const curve = night.temperatures;
    if (!curve) return;
    this.temperatures.show(curve, night.plan, night.head.began_utc, night.head.finishing_utc);
    if (!$("temperature-told").textContent) put("temperature-told", this.hint());
    if (this.legend === curve.columns.join()) return;
    this.legend = curve.columns.join();
    const styles = temperatureStyle(curve.columns);
    const entries = curve.columns.map((name, i) => entry(temperatureName(name), `curve-${styles[i].curve} ${styles[i].kind}`));
    $("temperature-legend").replaceChildren(...entries, entry("Plan, as it was made", "plan dotted"));
  }

  showRates(night) {
    this.showTiles(night.head.now);
    const rates = night.head.now ? night.head.now.rates : {};
    const labels = Object.keys(rates);
    const collecting = labels.some((label) => rates[label].mean !== null && rates[label].mean !== undefined);
    const about = collecting ? "Running average of this collect ± standard error so far; the band is one error wide on each side." : "Of this moment. Running averages begin with the next collect.";
    put("rates-about", labels.length ? about : "No rates are being read.");
    $("rates").classList.toggle("collecting", collecting);
    if (labels.join() !== [...this.channels.keys()].join()) this.makeChannels(labels);
    const curve = night.collect;
    const [times, least, greatest] = curve && curve.least.length ? points(curve, Infinity) : [[], [], []];
    for (const label of labels) {
      const channel = this.channels.get(label);
      const rate = rates[label];
      const [value, error] = collecting ? withError(rate.mean, rate.se) : [signed(rate.now, 1), ""];
      channel.mean.textContent = value;
      channel.se.textContent = error;
      channel.now.textContent = collecting ? `at this moment ${signed(rate.now, 1)}` : "";
      const mean = curve ? curve.columns.indexOf(`${label} mean`) : -1;
      const se = curve ? curve.columns.indexOf(`${label} se`) : -1;
      if (mean >= 0 && times.length > 1) channel.chart.show(times, least[mean], greatest[se]);
    }
  }

  showTiles(now) {
    const units = now ? Object.entries(now.unit_degC) : [];
    const tiles = [["Chamber", now && now.chamber_degC], ["Setpoint", now && now.setpoint_degC]];
    for (const [number, value] of units) tiles.push([`Sensor ${number}`, value]);
    $("tiles").hidden = !now;
    const parts = tiles.map(([name, value]) => {
      const tile = document.createElement("div");
      tile.append(element("dt", "", name), element("dd", "", degrees(value)));
      return tile;
    });
    $("tiles").replaceChildren(...parts);
  }

  makeChannels(labels) {
    this.channels.clear();
    const rows = labels.map((label) => {
      const row = element("div", "channel", "");
      const words = element("div", "", "");
      const mean = element("span", "mean", "");
      const se = element("span", "se", "");
      const now = element("div", "name", "");
      const chart = element("div", "mini", "");
      const value = element("div", "", "");
      value.append(mean, " ", se);
      words.append(element("div", "name", channelName(label)), value, now);
      row.append(words, chart);
      this.channels.set(label, { mean, se, now, chart: new AverageChart(chart) });
      return row;
    });
    $("rates").replaceChildren(...rows);
  }

  showEvents(events) {
    const items = [...events].reverse().map((event) => {
      const line = element("li", event.weight, "");
      const when = element("time", "", dayTime(event.at_utc));
      when.dateTime = event.at_utc;
      line.append(when, element("span", "kind", event.kind.replaceAll("-", " ").replaceAll("_", " ")), element("span", "message", sentence(event.message)));
      return line;
    });
    $("events").replaceChildren(...(items.length ? items : [item("Nothing has happened yet.")]));
  }
}

// What stands where the step would: the reason, unless the line at the top says it already.
function ending(head) {
  if (head.working) return "beginning …";
  if (head.killed) return "interrupted";
  if (head.verdict && head.verdict.verdict === "FAIL") return "ended, not good";
  return head.state === "failed" ? "ended early" : head.reason;
}

function noteOf(head) {
  if (head.pausing) return head.pausing;
  if (head.paused) return `paused by ${head.paused.by}${head.paused.why ? `: ${head.paused.why}` : ""}, since ${time(head.paused.since_utc)}`;
  if (!head.now) return "";
  const again = head.now.attempt > 1 ? `attempt ${head.now.attempt}` : "";
  return [again, head.now.note].filter(Boolean).join(", ");
}

function element(tag, className, content) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.textContent = content;
  return made;
}

const item = (content) => element("li", "", content);

function entry(name, className) {
  const line = element("li", className, "");
  line.append(document.createElement("i"), name);
  return line;
}

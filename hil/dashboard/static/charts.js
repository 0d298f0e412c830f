// The curves, drawn by uPlot: the night's temperatures against the plan, and each channel's running average.

import { points } from "./store.js";
import { dayTime, degrees, temperatureName } from "./words.js";

const GAP_S = 180;

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const font = "13px system-ui, sans-serif";

function axes() {
  const text = colour("--quiet");
  const line = { stroke: colour("--grid"), width: 1 };
  return { stroke: text, font, grid: line, ticks: line };
}

// Colour and dash of each temperature: the setpoint dashed, sensors in their own colours.
export function temperatureStyle(columns) {
  let sensor = 1;
  return columns.map((name) => {
    if (name === "chamber_degC") return { curve: 1, dash: [], kind: "" };
    if (name === "setpoint_degC") return { curve: 3, dash: [10, 5], kind: "dashed" };
    sensor = sensor === 2 ? 4 : 2;
    return { curve: sensor, dash: sensor === 4 ? [10, 4, 2, 4] : [], kind: sensor === 4 ? "dashdot" : "" };
  });
}

const CLOCK = [
  [86400, "{DD} {MMM}", null, null, null, null, null, null, 1],
  [3600, "{HH}:{mm}", "\n{WWW}", null, null, null, null, null, 1],
  [60, "{HH}:{mm}", "\n{WWW}", null, null, null, null, null, 1],
  [1, "{HH}:{mm}:{ss}", null, null, null, null, null, null, 1],
];

export class TemperatureChart {
  constructor(element, onTold) {
    this.element = element;
    this.onTold = onTold;
    this.plot = null;
    this.columns = "";
    new ResizeObserver(() => this.resize()).observe(element);
  }

  restyle() {
    this.plot?.destroy();
    this.plot = null;
  }

  show(curve, plan, beganUtc, endUtc) {
    const began = Date.parse(beganUtc) / 1000;
    const [times, least, greatest] = points(curve, Math.max(GAP_S, 5 * curve.width_s));
    const x = [];
    for (const at of times) x.push(began + at, began + at);
    const y = curve.columns.map((_, column) => {
      const values = [];
      for (let i = 0; i < times.length; i++) values.push(least[column][i], greatest[column][i]);
      return values;
    });
    this.began = began;
    this.plan = plan;
    const planned = began + (plan ? plan.total_s : 0);
    this.end = Math.max(planned, endUtc ? Date.parse(endUtc) / 1000 : 0, x.length ? x[x.length - 1] : 0);
    this.now = x.length ? x[x.length - 1] : null;
    if (!this.plot || this.columns !== curve.columns.join()) this.create(curve.columns);
    this.plot.setData([x, ...y]);
  }

  create(columns) {
    this.plot?.destroy();
    this.columns = columns.join();
    const styles = temperatureStyle(columns);
    const series = columns.map((label, i) => ({
      label,
      stroke: colour(`--curve-${styles[i].curve}`),
      dash: styles[i].dash,
      width: label === "setpoint_degC" ? 1.5 : 2.5,
      points: { show: false },
    }));
    const options = {
      ...this.size(),
      legend: { show: false },
      cursor: { y: false, drag: { x: false, y: false }, points: { size: 8 } },
      padding: [8, 12, 0, 0],
      scales: {
        x: { time: true, range: () => [this.began, Math.max(this.end, this.began + 60)] },
        y: { range: (plot, low, high) => this.range(low, high) },
      },
      axes: [
        { ...axes(), values: CLOCK, space: 70, size: 46 },
        { ...axes(), size: 46, values: (plot, ticks) => ticks.map((tick) => String(tick).replace("-", "−")) },
      ],
      series: [{}, ...series],
      hooks: { draw: [(plot) => this.drawPlan(plot)], setCursor: [(plot) => this.tell(plot, columns)] },
    };
    this.plot = new uPlot(options, [[], ...columns.map(() => [])], this.element);
    const finger = (event) => {
      const touch = event.touches[0];
      if (touch) this.plot.setCursor({ left: touch.clientX - this.plot.over.getBoundingClientRect().left, top: 10 });
    };
    for (const kind of ["touchstart", "touchmove"]) this.plot.over.addEventListener(kind, finger, { passive: true });
  }

  // What the curves show where the pointer or a finger is.
  tell(plot, columns) {
    const at = plot.cursor.idx;
    const values = at === null || at === undefined ? [] : columns.map((name, i) => `${temperatureName(name)} ${degrees(plot.data[i + 1][at])}`);
    this.onTold(values.length ? `${dayTime(1000 * plot.data[0][at])}: ${values.join(", ")} °C` : "");
  }

  range(low, high) {
    const planned = (this.plan ? this.plan.corners : []).map((corner) => corner[1]);
    const values = [low, high, ...planned].filter((value) => value !== null && isFinite(value));
    if (!values.length) return [0, 30];
    const [least, greatest] = [Math.min(...values), Math.max(...values)];
    const margin = Math.max(2, 0.06 * (greatest - least));
    return [least - margin, greatest + margin];
  }

  // The plan is a line of its own corners, drawn below the curves' end; and where the night has got to.
  drawPlan(plot) {
    const { ctx } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
    ctx.clip();
    ctx.strokeStyle = colour("--plan");
    ctx.lineWidth = 1.5 * devicePixelRatio;
    if (this.plan && this.plan.corners.length) {
      ctx.setLineDash([2 * devicePixelRatio, 4 * devicePixelRatio]);
      ctx.beginPath();
      this.plan.corners.forEach(([at, value], i) => {
        const px = plot.valToPos(this.began + at, "x", true);
        const py = plot.valToPos(value, "y", true);
        if (i) ctx.lineTo(px, py);
        else ctx.moveTo(px, py);
      });
      ctx.stroke();
    }
    if (this.now !== null) {
      const px = plot.valToPos(this.now, "x", true);
      ctx.setLineDash([]);
      ctx.lineWidth = devicePixelRatio;
      ctx.beginPath();
      ctx.moveTo(px, plot.bbox.top);
      ctx.lineTo(px, plot.bbox.top + plot.bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  size() {
    return { width: Math.max(this.element.clientWidth, 200), height: 260 };
  }

  resize() {
    if (this.plot && this.plot.width !== this.size().width) this.plot.setSize(this.size());
  }
}

// A running mean with one standard error about it, which narrows as the collect goes on.
export class AverageChart {
  constructor(element) {
    this.element = element;
    this.plot = null;
  }

  restyle() {
    this.plot?.destroy();
    this.plot = null;
  }

  show(times, mean, error) {
    if (!this.plot) this.create();
    const edge = (sign) => mean.map((value, i) => (value === null || error[i] === null ? null : value + sign * error[i]));
    this.plot.setData([times, edge(1), edge(-1), mean]);
  }

  create() {
    const band = colour("--curve-1");
    const options = {
      width: this.element.clientWidth || 128,
      height: 56,
      legend: { show: false },
      cursor: { show: false },
      padding: [2, 2, 2, 2],
      scales: { x: { time: false }, y: { range: (plot) => settledRange(plot.data) } },
      axes: [{ show: false }, { show: false }],
      series: [
        {},
        { stroke: "transparent", points: { show: false } },
        { stroke: "transparent", points: { show: false } },
        { stroke: band, width: 2, points: { show: false } },
      ],
      bands: [{ series: [1, 2], fill: `${band}40` }],
    };
    this.plot = new uPlot(options, [[], [], [], []], this.element);
  }
}

// The first few means scatter so much that nothing else would be seen: the range is that of what came after them.
function settledRange([times, high, low]) {
  const from = Math.floor(times.length / 5);
  const values = [...high.slice(from), ...low.slice(from)].filter((value) => value !== null && value !== undefined);
  if (!values.length) return [-1, 1];
  const [least, greatest] = [Math.min(...values), Math.max(...values)];
  const margin = 0.1 * (greatest - least) || 1;
  return [least - margin, greatest + margin];
}


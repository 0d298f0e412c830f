// What the page knows of the nights: whole at first, then brought up to date by what changed.

export class Store {
  constructor() {
    this.nights = new Map();
    this.folder = "";
    this.utc = null;
    this.notShown = 0;
    this.problem = "";
    this.reports = "";
    this.units = "";
  }

  // Take one frame in; return the names of the parts that changed, by night, or null where other nights are shown, or
  // in another order.
  take(frame) {
    this.folder = frame.folder;
    this.utc = frame.utc;
    this.notShown = frame.not_shown;
    this.problem = frame.problem;
    this.reports = frame.reports;
    this.units = frame.units;
    if (frame.problem) return new Map();
    const before = [...this.nights.keys()].join("\n");
    const changed = new Map();
    for (const [id, parts] of Object.entries(frame.nights)) {
      const night = this.nights.get(id) || {};
      for (const [name, part] of Object.entries(parts)) night[name] = isCurve(part) ? grown(night[name], part) : part;
      this.nights.set(id, night);
      changed.set(id, new Set(Object.keys(parts)));
    }
    const shown = frame.shown.filter((id) => this.nights.has(id));
    this.nights = new Map(shown.map((id) => [id, this.nights.get(id)]));
    return shown.join("\n") === before ? changed : null;
  }
}

const isCurve = (part) => part && part.least !== undefined;

// A curve comes with everything from one bucket on; where the buckets are others than before, with everything.
function grown(before, part) {
  if (!before || part.from === 0 || part.width_s !== before.width_s || part.start_s !== before.start_s) return part;
  for (const side of ["least", "greatest"]) {
    part[side].forEach((values, column) => {
      const known = before[side][column];
      known.length = Math.min(known.length, part.from);
      for (const value of values) known.push(value);
    });
  }
  return before;
}

// Return [times, least, greatest] of a curve's buckets that hold anything; a null is put into gaps that are too long.
export function points(curve, gap_s) {
  const times = [];
  const least = curve.columns.map(() => []);
  const greatest = curve.columns.map(() => []);
  const buckets = curve.least.length ? curve.least[0].length : 0;
  let last = null;
  for (let bucket = 0; bucket < buckets; bucket++) {
    if (curve.least.every((column) => column[bucket] === null || column[bucket] === undefined)) continue;
    const at = curve.start_s + (bucket + 0.5) * curve.width_s;
    if (last !== null && at - last > gap_s) {
      times.push((at + last) / 2);
      for (const column of [...least, ...greatest]) column.push(null);
    }
    last = at;
    times.push(at);
    curve.columns.forEach((_, column) => {
      least[column].push(curve.least[column][bucket]);
      greatest[column].push(curve.greatest[column][bucket]);
    });
  }
  return [times, least, greatest];
}

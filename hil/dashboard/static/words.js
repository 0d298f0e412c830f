// Numbers, durations and times as a technician would say them.

export function duration(seconds) {
  if (seconds === null || seconds === undefined || !isFinite(seconds)) return "–";
  const s = Math.max(0, Math.round(seconds));
  if (s < 100) return `${s} s`;
  const minutes = Math.round(s / 60);
  if (minutes < 100) return `${minutes} min`;
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

// How long something has lasted that is read out when it changes: not every second.
export const age = (seconds) => duration(seconds < 10 ? seconds : Math.floor(seconds / 10) * 10);

// A countdown: 4:59 or 1:02:03.
export function countdown(seconds) {
  const s = Math.max(0, Math.round(seconds));
  const two = (n) => String(n).padStart(2, "0");
  const rest = `${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
  return s >= 3600 ? `${Math.floor(s / 3600)}:${rest}` : rest.replace(/^0/, "");
}

const DAY_TIME = new Intl.DateTimeFormat("en-GB", { weekday: "short", hour: "2-digit", minute: "2-digit", timeZoneName: "short" });
const DATE_TIME = new Intl.DateTimeFormat("en-GB", { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit", timeZoneName: "short" });
const TIME = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit", timeZoneName: "short" });

export const dayTime = (utc) => DAY_TIME.format(new Date(utc)).replace(",", "");
export const dateTime = (utc) => DATE_TIME.format(new Date(utc));
// The zone that every clock time here is in.
export const zone = () => DAY_TIME.formatToParts(new Date()).find((part) => part.type === "timeZoneName").value;
export const time = (utc) => TIME.format(new Date(utc));

export function signed(value, digits) {
  if (value === null || value === undefined) return "–";
  return (value < 0 ? "−" : "+") + Math.abs(value).toFixed(digits);
}

export function degrees(value) {
  return value === null || value === undefined ? "–" : value.toFixed(1).replace("-", "−");
}

// So many digits that the error has two: what is behind them says nothing.
export function digitsFor(error) {
  if (!error || !isFinite(error)) return 1;
  return Math.min(4, Math.max(0, 1 - Math.floor(Math.log10(error))));
}

export function withError(value, error) {
  const digits = digitsFor(error);
  return [signed(value, digits), error === null || error === undefined ? "" : `± ${error.toFixed(digits)}`];
}

// "2.RA" is channel RA of sensor 2; "unit_2_degC" its temperature.
export function channelName(label) {
  const [sensor, channel] = label.split(".");
  return `Sensor ${sensor} ${channel}`;
}

export function temperatureName(column) {
  if (column === "chamber_degC") return "Chamber";
  if (column === "setpoint_degC") return "Setpoint";
  const unit = /^unit_(.+)_degC$/.exec(column);
  return unit ? `Sensor ${unit[1]}` : column;
}

// A sentence of the controller, with a minus sign where a number is below zero, and no number parted from its unit.
export const sentence = (text) => text.replace(/(^|[\s(])-(?=\d)/g, "$1−").replaceAll(" °C", "\u00a0°C");

export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

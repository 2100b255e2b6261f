// Elements, words and axes that all parts of the page share. Text only ever goes in as text.
const SVG = "http://www.w3.org/2000/svg";
const GOOD = ["running", "current", "clear", "info", "accepted", "finished"];
const BAD = ["failed", "stopped", "refused", "unusable", "alarm"];
const NEUTRAL = ["retired", "cloudy"];
const STEPS_MS = [60, 300, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 432000, 864000, 2592000].map((s) => s * 1000);

export const $ = (id) => document.getElementById(id);

export function element(name, attributes = {}, text = null) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  return made;
}

// A number and its unit, a sign and its number, and the two values of a ± stay in one line.
const UNIT = "(?:px|°|%|s|ms|µs|min|h|d|days?|MB|GB|KiB|MiB|GiB|km|m|mm|µm|hPa|Pa|K|°C|mag|UTC|Hz|kHz|images?|sightings?|times|sigmas?)";
const AFTER_NUMBER = new RegExp(`(\\d) (?=${UNIT}(?![\\wµ°]))`, "g");
export const unbroken = (text) => text.replace(/ ?± ?/g, (found) => found.replaceAll(" ", "\u00a0")).replace(AFTER_NUMBER, "$1\u00a0");

// Text as nodes: what stands between backticks is code, to be typed as it stands.
export function written(text) {
  const all = document.createDocumentFragment();
  String(text).split("`").forEach((part, k, parts) => {
    const isCode = k % 2 === 1 && k < parts.length - 1;
    if (!isCode) { all.append(unbroken(k % 2 ? `\`${part}` : part)); return; }
    const made = document.createElement("code");
    made.textContent = part;
    all.append(made);
  });
  return all;
}

// Give an element a text; one that it has already is left, so that no reader hears it again.
export function write(made, text) {
  if (made.dataset.text !== text) made.replaceChildren(written(text));
  made.dataset.text = text;
}

export function node(name, text = "", className = "") {
  const made = document.createElement(name);
  if (text !== "") made.append(name === "code" ? text : written(text));
  if (className) made.className = className;
  return made;
}

export const fixed = (value, digits, unit = "") => (value === null || value === undefined ? "–" : `${value.toFixed(digits)}${unit}`);
// as many digits as tell something: 0.00312, 0.27, 12.4
export const telling = (value, unit = "") => (value === null || value === undefined ? "–" : `${value === 0 ? 0 : Number(value.toPrecision(3))}${unit}`);
export const moment = (time) => (time ? time.replace("T", " ").replace(/(\.\d+)?Z$/, "") : "–");

// A time in UTC, to the second or of fewer characters, and in the site's zone where that is another; the date again where it differs.
export function zoned(time, zone, length = 19) {
  const [utc, there] = [moment(time).slice(0, length), time && zone ? localTime(time, zone) : null];
  if (!there || there === utc.slice(0, 16)) return `${utc} UTC`;
  return `${utc} UTC · ${there.slice(0, 10) === utc.slice(0, 10) ? there.slice(11) : there} ${zone}`;
}

function localTime(time, zone) {
  try {
    const format = { timeZone: zone, hourCycle: "h23", year: "numeric", month: "2-digit", day: "2-digit", hour: "2-digit", minute: "2-digit" };
    const part = Object.fromEntries(new Intl.DateTimeFormat("en", format).formatToParts(new Date(time)).map(({ type, value }) => [type, value]));
    return `${part.year}-${part.month}-${part.day} ${part.hour}:${part.minute}`;
  } catch { return null; } // a zone that this browser does not know
}

export function ago(time, now) {
  if (!time) return "never";
  const seconds = Math.max(0, (Date.parse(now) - Date.parse(time)) / 1000);
  if (seconds < 120) return `${seconds.toFixed(0)} s ago`;
  if (seconds < 7200) return `${(seconds / 60).toFixed(0)} min ago`;
  return seconds < 172800 ? `${(seconds / 3600).toFixed(0)} h ago` : `${(seconds / 86400).toFixed(0)} days ago`;
}

// A word with a sign and a colour, so that no meaning hangs on the colour alone.
export function judged(word) {
  const kind = GOOD.includes(word) ? "good" : BAD.includes(word) ? "bad" : NEUTRAL.includes(word) ? "none" : "warn";
  const made = node("span", "", kind);
  const sign = node("span", { good: "✓", bad: "✕", warn: "!", none: "·" }[kind]);
  sign.setAttribute("aria-hidden", "true");
  made.append(sign, ` ${word}`);
  return made;
}

// Findings as their sentences; each element carries the code.
export function sentences(texts, findings) {
  const all = document.createDocumentFragment();
  texts.forEach((text, k) => {
    const one = node("span", text);
    one.dataset.code = one.title = findings[k].code;
    all.append(k ? "; " : "", one);
  });
  return all;
}

export function fillRows(id, rows, empty) {
  const body = $(id).tBodies[0];
  const titles = [...$(id).tHead.rows[0].cells].map((cell) => cell.textContent);
  body.replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    cells.forEach((cell, k) => {
      const td = document.createElement("td");
      td.dataset.title = titles[k]; // shown beside it where the screen is narrow
      td.append(typeof cell === "string" ? written(cell) : cell);
      row.append(td);
    });
    return row;
  }));
  if (rows.length) return;
  const td = node("td", empty, "none");
  td.colSpan = $(id).tHead.rows[0].cells.length;
  body.append(document.createElement("tr"));
  body.firstChild.append(td);
}

export function fillFacts(id, facts) {
  $(id).replaceChildren(...Object.entries(facts).flatMap(([name, value]) => {
    const dd = document.createElement("dd");
    dd.append(typeof value === "string" ? written(value) : value);
    return [node("dt", name), dd];
  }));
}

// A path through pixels; it is broken where there is none.
export function path(pixels) {
  let pen = "M";
  return pixels.map((p) => { const step = p ? `${pen}${p[0]} ${p[1]}` : ""; pen = p ? "L" : "M"; return step; }).join("");
}

export const mark = (d, style, at, scale) => element("path", { class: style, d, transform: `translate(${at[0]} ${at[1]}) scale(${scale})` });
export function label(at, text, size, style) {
  const made = element("text", { class: style, x: at[0], y: at[1], "text-anchor": "middle", "dominant-baseline": "middle" }, text);
  made.style.fontSize = `${size}px`; // of the drawing, whatever a style sheet says
  return made;
}

export function symbol(style, x, y, r) {
  if (style === "x-mark") return element("circle", { class: style, cx: x, cy: y, r });
  if (style === "z-mark") return element("path", { class: style, d: `M${x} ${y - 1.2 * r}L${x + 1.2 * r} ${y + r}H${x - 1.2 * r}Z` });
  return element("rect", { class: style, x: x - r, y: y - r, width: 2 * r, height: 2 * r });
}

export function ticksOf(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((k) => k * power >= raw * (1 - 1e-9)) * power;
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high * (1 + 1e-9); k += 1) ticks.push(k * step);
  return { ticks, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

export function timeTicks(from, to, most, least = 0) {
  const step = STEPS_MS.find((one) => one >= least && (to - from) / one <= most) ?? STEPS_MS.at(-1);
  const ticks = [];
  for (let at = Math.ceil(from / step) * step; at <= to; at += step) ticks.push(at);
  const written = (at) => new Date(at).toISOString();
  return ticks.map((at) => [at, at % 86400000 ? written(at).slice(11, 16) : written(at).slice(5, 10)]); // a midnight is its date
}

// An entry of a legend.
export function keyed(mark, text, viewBox = "0 0 10 10") {
  const item = node("li", ` ${text}`);
  const key = element("svg", { viewBox, "aria-hidden": "true" });
  key.append(mark);
  item.prepend(key);
  return item;
}

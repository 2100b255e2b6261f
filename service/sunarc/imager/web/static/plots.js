// Plots by time: axes with labels, and series of symbols.
import { $, element, symbol, ticksOf, timeTicks } from "./draw.js";

export const DAY_MS = 86400000;
const [HEIGHT, LEFT, BOTTOM] = [150, 72, 24]; // LEFT holds -0.00004

// Series of [time, value], one symbol each; the scale holds 0. Days have no hours: `least` is the closest that labels stand.
export function drawSeries(id, series, least = DAY_MS) {
  const values = series.flatMap(([, points]) => points.map(([, value]) => value));
  const [low, high] = [Math.min(0, ...values) * 1.15, Math.max(0, ...values) * 1.15];
  const frame = axes(id, series.flatMap(([, points]) => points.map(([at]) => at)), low, Math.max(high, low < 0 ? 0 : 1e-6), least);
  for (const [style, points] of series) for (const [at, value] of points) frame.parts.push(symbol(style, frame.x(at), frame.y(value), 3));
  $(id).replaceChildren(...frame.parts);
}

export function axes(id, times, low, high, least = DAY_MS) {
  const plot = $(id);
  const width = plot.clientWidth || 600;
  plot.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
  const from = Math.min(...times);
  const to = Math.max(...times, from + 1);
  const x = (time) => LEFT + 8 + ((time - from) / (to - from)) * (width - LEFT - 32); // half a label beyond the last point
  const y = (value) => 8 + (1 - (value - low) / (high - low)) * (HEIGHT - 16 - BOTTOM);
  const { ticks, digits } = ticksOf(low, high, 4);
  const parts = ticks.flatMap((tick) => [
    element("path", { class: Math.abs(tick) < 1e-12 && low < 0 ? "zero" : "grid", d: `M${LEFT} ${y(tick)}H${width - 8}` }),
    element("text", { x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, tick.toFixed(digits)),
  ]);
  const named = to - from > 400 * DAY_MS ? yearTicks(from, to) : timeTicks(from, to, width / 90, least);
  if (!named.length) named.push([from, new Date(from).toISOString().slice(0, 10)]);
  for (const [at, text] of named) parts.push(element("text", { x: x(at), y: HEIGHT - 6, "text-anchor": "middle" }, text));
  return { x, y, parts };
}

function yearTicks(from, to) {
  const ticks = [];
  for (let year = new Date(from).getUTCFullYear() + 1; Date.UTC(year, 0) <= to; year += 1) ticks.push([Date.UTC(year, 0), String(year)]);
  return ticks;
}

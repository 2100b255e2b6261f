// Accepted calibrations over time: how sure each is of the sky, and what its fit left over. Scales begin at 0.
import { $, element, symbol, telling, ticksOf, timeTicks } from "./draw.js";

const DAY_MS = 86400000;
const [HEIGHT, LEFT, BOTTOM] = [150, 60, 24];

export function drawHistory(calibrations) {
  const known = calibrations.filter((one) => one.accepted && one.sky_rms_deg !== null).map((one) => ({ ...one, at: Date.parse(one.created_at) }));
  const newest = Math.max(...known.map((one) => one.at));
  const shown = known.filter((one) => one.at >= newest - Number($("history-span").value) * DAY_MS);
  $("history-plots").hidden = !shown.length;
  $("history-sum").textContent = shown.length
    ? `${shown.length} accepted; 1-sigma over the sky ${range(shown, "sky_rms_deg", "°")}, RMSE ${range(shown, "rmse_px", " px")}.`
    : "No accepted calibration yet.";
  if (!shown.length) return;
  draw("history-sigma", shown, "sky_rms_deg", "x-mark");
  draw("history-rmse", shown.filter((one) => one.rmse_px !== null), "rmse_px", "y-mark");
}

function range(shown, field, unit) {
  const values = shown.map((one) => one[field]).filter((value) => value !== null);
  return values.length ? `${telling(Math.min(...values))} to ${telling(Math.max(...values), unit)}` : "not known";
}

function draw(id, shown, field, style) {
  const plot = $(id);
  const width = plot.clientWidth || 600;
  plot.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
  const from = Math.min(...shown.map((one) => one.at));
  const to = Math.max(...shown.map((one) => one.at), from + 1);
  const most = Math.max(...shown.map((one) => one[field]), 1e-6) * 1.15;
  const x = (time) => LEFT + 8 + ((time - from) / (to - from)) * (width - LEFT - 24);
  const y = (value) => 8 + (1 - value / most) * (HEIGHT - 16 - BOTTOM);
  const { ticks, digits } = ticksOf(0, most, 4);
  const parts = ticks.flatMap((tick) => [
    element("path", { class: "grid", d: `M${LEFT} ${y(tick)}H${width - 8}` }),
    element("text", { x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, tick.toFixed(digits)),
  ]);
  const named = to - from > 400 * DAY_MS ? yearTicks(from, to) : timeTicks(from, to, width / 90);
  for (const [at, text] of named) parts.push(element("text", { x: x(at), y: HEIGHT - 6, "text-anchor": "middle" }, text));
  for (const one of shown) parts.push(symbol(style, x(one.at), y(one[field]), 3));
  plot.replaceChildren(...parts);
}

function yearTicks(from, to) {
  const ticks = [];
  for (let year = new Date(from).getUTCFullYear() + 1; Date.UTC(year, 0) <= to; year += 1) ticks.push([Date.UTC(year, 0), String(year)]);
  return ticks;
}

// What hides the sky: the mask over the picture, the horizon with the sun's year, and the hours of sun that are lost.
import { ask, askImage } from "./ask.js";
import { $, element, ticksOf, write } from "./draw.js";

const [HEIGHT, LEFT, BOTTOM] = [190, 40, 24];
const DIRECTIONS = ["N", "NE", "E", "SE", "S", "SW", "W", "NW", "N"];
const MONTHS = "JFMAMJJASOND";
let shownOf = null;

export async function readHorizon(status) {
  const found = status?.obstructions ? await ask("/v1/horizon") : null;
  $("obstructions").hidden = $("mask-choice").hidden = !found;
  if (!found) return;
  drawProfile(found);
  drawLost(found);
  await showMask(found.time);
}

// The mask is asked for where it is wanted, and again when it was made anew.
export async function showMask(time = shownOf) {
  const wanted = $("show-mask").checked && !$("mask-choice").hidden;
  $("mask").hidden = !wanted;
  if (!wanted || (shownOf === time && $("mask").src)) return;
  const image = await askImage("/v1/masks/obstructions");
  if (!image) return;
  shownOf = time;
  const before = $("mask").src;
  $("mask").src = image.address;
  if (before) URL.revokeObjectURL(before);
}

function frameOf(id, from, to, high, named) {
  const width = $(id).clientWidth || 600;
  $(id).setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
  const x = (value) => LEFT + ((value - from) / (to - from)) * (width - LEFT - 12);
  const y = (value) => 8 + (1 - value / high) * (HEIGHT - 16 - BOTTOM);
  const { ticks, digits } = ticksOf(0, high, 5);
  const parts = ticks.flatMap((tick) => [
    element("path", { class: "grid", d: `M${LEFT} ${y(tick)}H${width - 12}` }),
    element("text", { x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, tick.toFixed(digits)),
  ]);
  for (const [at, text] of named) parts.push(element("text", { x: x(at), y: HEIGHT - 6, "text-anchor": "middle" }, text));
  return { x, y, parts };
}

function drawProfile(found) {
  const top = Math.max(...found.elevation_deg.filter((one) => one !== null), ...found.sun_paths.flatMap((way) => way.elevation_deg));
  const { x, y, parts } = frameOf("horizon-plot", 0, 360, Math.min(90, top + 5), DIRECTIONS.map((name, k) => [45 * k, name]));
  const edge = found.elevation_deg.map((one, azimuth) => `L${x(azimuth)} ${y(one ?? 0)}`).join("");
  parts.push(element("path", { class: "hidden-sky", d: `M${x(0)} ${y(0)}${edge}L${x(360)} ${y(found.elevation_deg[0] ?? 0)}V${y(0)}Z` }));
  for (const [azimuth, spans] of found.openings_deg.entries()) {
    for (const [low, high] of spans) parts.push(element("path", { class: "opening", d: `M${x(azimuth)} ${y(low)}V${y(high)}` }));
  }
  for (const way of found.sun_paths) {
    const rows = way.azimuth_deg.map((azimuth, k) => [azimuth, way.elevation_deg[k]]);
    const line = rows.map(([azimuth, elevation], k) => `${k && Math.abs(azimuth - rows[k - 1][0]) < 180 ? "L" : "M"}${x(azimuth)} ${y(elevation)}`).join("");
    parts.push(element("path", { class: "over sun-way", d: line }));
    const highest = rows.reduce((best, row) => (row[1] > best[1] ? row : best));
    parts.push(element("text", { x: x(highest[0]), y: y(highest[1]) - 4, "text-anchor": "middle" }, way.name));
  }
  $("horizon-plot").replaceChildren(...parts);
}

function drawLost({ lost_h: lost, sun_h: sun, drawn }) {
  const [all, gone] = [sun, lost].map((hours) => hours.reduce((total, one) => total + one, 0));
  write($("horizon-sum"), `Obstructions hide the sun for ${gone.toFixed(0)} h of the ${all.toFixed(0)} h a year that it is up (${((100 * gone) / Math.max(all, 1)).toFixed(1)} %)${drawn ? `; the drawn mask agrees with ${(100 * drawn.agreement).toFixed(0)} % of them` : ""}. Hours hidden by month:`);
  const { x, y, parts } = frameOf("lost-plot", -0.5, 11.5, Math.max(...lost, 1) * 1.1, [...MONTHS].entries());
  for (const [month, hours] of lost.entries()) {
    const bar = element("rect", { class: "shade-3 bar", x: x(month - 0.35), width: x(0.35) - x(-0.35), y: y(hours), height: y(0) - y(hours) });
    bar.append(element("title", {}, `${hours.toFixed(1)} h of ${sun[month].toFixed(0)} h`));
    parts.push(bar);
  }
  $("lost-plot").replaceChildren(...parts);
}

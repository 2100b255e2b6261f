// Sighting minus calibration: by time, and as arrows over the image.
import { $, element, label, node, path, symbol, telling, ticksOf, timeTicks, write } from "./draw.js";
import { compass } from "./sky.js";

// Of the accepted sightings alone, and of those since the camera last moved: the calibration says nothing of others.
export function drawResiduals(points, overlay, size, poseEpoch) {
  const unit = document.querySelector("input[name=unit]:checked").value;
  const known = points.filter((point) => point.accepted && point.residual && (!poseEpoch || point.pose_epoch === poseEpoch));
  write($("residual-sum"), known.length
    ? `RMSE of the last ${known.length} accepted sightings: ${telling(rmse(known, "distance_px"), " px")}, ${telling(rmse(known, "distance_deg"), "°")}.`
    : "No accepted sighting with a calibration to compare it with yet.");
  $("plots").hidden = !known.length;
  if (!known.length) return;
  const series = unit === "px"
    ? [["x-mark", "x, px", (r) => r.x_px], ["y-mark", "y, px", (r) => r.y_px]]
    : [["x-mark", "distance, degrees", (r) => r.distance_deg]];
  drawByTime(known, series);
  drawBySky(known, overlay, size ?? [1, 1]);
  $("by-time-legend").replaceChildren(...series.map(([style, name]) => {
    const item = node("li", ` ${name}`);
    const key = element("svg", { viewBox: "-10 -10 20 20", "aria-hidden": "true" });
    key.append(symbol(style, 0, 0, 4));
    item.prepend(key);
    return item;
  }));
}

function rmse(points, field) {
  const values = points.map((point) => point.residual[field]).filter((value) => value !== null);
  return values.length ? Math.sqrt(values.reduce((sum, value) => sum + value ** 2, 0) / values.length) : null;
}

function drawByTime(points, series) {
  const plot = $("by-time");
  const [width, height, left, bottom] = [plot.clientWidth || 600, 240, 60, 24];
  plot.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const times = points.map((point) => Date.parse(point.time));
  const from = Math.min(...times);
  const to = Math.max(...times, from + 1);
  const values = series.flatMap(([, , pick]) => points.map((point) => pick(point.residual) ?? 0)).map(Math.abs).sort((a, b) => a - b);
  const reach = Math.max(values[Math.floor(values.length * 0.995)] ?? 0, 1e-6) * 1.15;
  const low = series.length === 1 ? 0 : -reach;
  const x = (time) => left + ((time - from) / (to - from)) * (width - left - 24); // half a label beyond the last point
  const y = (value) => 8 + (1 - (Math.max(low, Math.min(reach, value)) - low) / (reach - low)) * (height - 16 - bottom);
  const { ticks, digits } = ticksOf(low, reach, 5);
  const parts = ticks.flatMap((tick) => [
    element("path", { class: Math.abs(tick) < 1e-12 ? "zero" : "grid", d: `M${left} ${y(tick)}H${width - 8}` }),
    element("text", { x: left - 6, y: y(tick) + 4, "text-anchor": "end" }, tick.toFixed(digits)),
  ]);
  for (const [at, text] of timeTicks(from, to, width / 70)) {
    parts.push(element("text", { x: x(at), y: height - 6, "text-anchor": "middle" }, text));
  }
  for (const [style, , pick] of series) {
    points.forEach((point, k) => { if (pick(point.residual) !== null) parts.push(symbol(style, x(times[k]), y(pick(point.residual)), 2)); });
  }
  plot.replaceChildren(...parts);
}

function drawBySky(points, overlay, [width, height]) {
  const plot = $("by-sky");
  const [across, down] = [400, (400 * height) / width];
  const s = across / width;
  plot.setAttribute("viewBox", `0 0 ${across} ${down}`);
  const onto = (at) => at && [(at[0] + 0.5) * s, (at[1] + 0.5) * s];
  const parts = (overlay?.zenith_circles ?? []).map((circle) => element("path", { class: "grid", d: path(circle.pixels.map(onto)) }));
  compass(overlay).forEach(([name, at]) => parts.push(label(onto(at), name, 13, "")));
  const lengths = points.map((point) => point.residual.distance_px).sort((a, b) => a - b);
  const typical = lengths[Math.floor(lengths.length * 0.9)] || 1;
  const unit = ticksOf(0, typical * 1.5, 2).ticks.at(-1) || typical;
  const stride = Math.max(1, Math.ceil(points.length / 200));
  for (let k = 0; k < points.length; k += stride) {
    const { residual, x_px, y_px } = points[k];
    const [x, y] = onto([x_px, y_px]);
    const scale = Math.min(24 / typical, 60 / residual.distance_px);
    parts.push(element("circle", { class: "tail", cx: x, cy: y, r: 1.6 }), element("path", { class: "arrow", d: `M${x} ${y}l${residual.x_px * scale} ${residual.y_px * scale}` }));
  }
  parts.push(element("path", { class: "scale-bar", d: `M12 ${down - 12}h${(unit * 24) / typical}` }), element("text", { x: 12, y: down - 20 }, telling(unit, " px")));
  plot.replaceChildren(...parts);
}

// What was: calibrations, the camera's rotation, looks at the sun and the clock, over a span that is chosen.
import { $, element, keyed, symbol, telling, write } from "./draw.js";
import { axes, DAY_MS, drawSeries } from "./plots.js";

const AXES = [["x-mark", "about east"], ["y-mark", "about north"], ["z-mark", "about up"]];
const VERDICTS = 6; // shades that tell them apart

export const spanDays = () => Number($("history-span").value);

export function drawHistory(calibrations, days, counts, housekeeping) {
  drawCalibrations(calibrations);
  const within = (rows) => { // of the span that ends with the newest row
    const dated = rows.map((row) => ({ ...row, at: Date.parse(row.date) }));
    const newest = Math.max(...dated.map((row) => row.at));
    return dated.filter((row) => row.at > newest - spanDays() * DAY_MS);
  };
  drawOffsets(within(days).filter((day) => day.pose_offset_deg));
  drawCounts(within(counts));
  drawHousekeeping(within(housekeeping.rows.map((row) => ({ ...row, date: row.time }))), housekeeping.step);
}

function drawCalibrations(calibrations) {
  const known = calibrations.filter((one) => one.accepted && one.sky_rms_deg !== null).map((one) => ({ ...one, at: Date.parse(one.created_at) }));
  const newest = Math.max(...known.map((one) => one.at));
  const shown = known.filter((one) => one.at >= newest - spanDays() * DAY_MS);
  $("history-plots").hidden = !shown.length;
  write($("history-sum"), shown.length
    ? `${shown.length} accepted; 1-sigma over the sky ${range(shown, "sky_rms_deg", "°")}, RMSE ${range(shown, "rmse_px", " px")}.`
    : "No accepted calibration yet.");
  if (!shown.length) return;
  drawSeries("history-sigma", [["x-mark", shown.map((one) => [one.at, one.sky_rms_deg])]], 0);
  drawSeries("history-rmse", [["y-mark", shown.filter((one) => one.rmse_px !== null).map((one) => [one.at, one.rmse_px])]], 0);
}

function drawOffsets(days) {
  $("offset-plot").hidden = !days.length;
  if (!days.length) return;
  drawSeries("history-offset", AXES.map(([style], k) => [style, days.map((day) => [day.at, day.pose_offset_deg[k]])]));
  $("offset-legend").replaceChildren(...AXES.map(([style, name]) => keyed(symbol(style, 0, 0, 4), name, "-10 -10 20 20")));
}

// A bar a day, as high as there were looks, in parts by verdict: the most frequent verdict lowest.
function drawCounts(days) {
  $("counts-plot").hidden = !days.length;
  if (!days.length) return;
  const totals = new Map();
  for (const day of days) for (const [verdict, count] of Object.entries(day.verdicts)) totals.set(verdict, (totals.get(verdict) ?? 0) + count);
  const verdicts = [...totals.keys()].sort((a, b) => totals.get(b) - totals.get(a));
  const shade = (k) => `shade-${VERDICTS - 1 - (k % VERDICTS)}`;
  write($("counts-sum"), `Detections per day, by result${spanDays() > days.length && spanDays() > 366 ? ", of the last 366 days" : ""}`);
  $("counts-legend").replaceChildren(...verdicts.map((verdict, k) => keyed(element("rect", { class: shade(k), width: 10, height: 10 }), `${verdict} (${totals.get(verdict)})`)));
  const highest = Math.max(...days.map((day) => Object.values(day.verdicts).reduce((sum, count) => sum + count, 0)));
  const frame = axes("history-counts", days.map((day) => day.at), 0, highest * 1.05);
  const width = Math.max(1, Math.min(14, (frame.x(days[0].at) - frame.x(days[0].at - DAY_MS)) * 0.8));
  for (const day of days) {
    let below = 0;
    verdicts.forEach((verdict, k) => {
      const count = day.verdicts[verdict] ?? 0;
      if (count) frame.parts.push(element("rect", { class: `bar ${shade(k)}`, x: frame.x(day.at) - width / 2, y: frame.y(below + count), width, height: frame.y(below) - frame.y(below + count) }));
      below += count;
    });
  }
  $("history-counts").replaceChildren(...frame.parts);
  drawSeries("history-clock", [["x-mark", days.filter((day) => day.clock_error_s !== null).map((day) => [day.at, day.clock_error_s])]]);
}

// Free space, and the temperature as its mean with a line from the lowest to the highest, by hour or by day.
function drawHousekeeping(rows, step) {
  const space = rows.filter((row) => row.disk_free_bytes !== null);
  $("disk-plot").hidden = !space.length;
  $("disk-sum").textContent = `Minimum free disk space per ${step}, GB`;
  if (space.length) drawSeries("history-disk", [["x-mark", space.map((row) => [row.at, row.disk_free_bytes / 1e9])]], step === "day" ? DAY_MS : 0);
  const warm = rows.filter((row) => row.temperature_c !== null);
  $("temperature-plot").hidden = !warm.length;
  $("temperature-sum").textContent = `Temperature of the camera per ${step}: mean, minimum and maximum, °C`;
  if (!warm.length) return;
  const [low, high] = [Math.min(...warm.map((row) => row.temperature_min_c)), Math.max(...warm.map((row) => row.temperature_max_c))];
  const margin = Math.max(0.1 * (high - low), 0.5);
  const frame = axes("history-temperature", warm.map((row) => row.at), low - margin, high + margin, step === "day" ? DAY_MS : 0);
  for (const row of warm) {
    const x = frame.x(row.at);
    frame.parts.push(element("path", { class: "range", d: `M${x} ${frame.y(row.temperature_min_c)}V${frame.y(row.temperature_max_c)}` }), symbol("y-mark", x, frame.y(row.temperature_c), 2));
  }
  $("history-temperature").replaceChildren(...frame.parts);
}

function range(shown, field, unit) {
  const values = shown.map((one) => one[field]).filter((value) => value !== null);
  if (!values.length) return "not known";
  const [low, high] = [Math.min(...values), Math.max(...values)];
  return low === high ? telling(high, unit) : `${telling(low)} to ${telling(high, unit)}`;
}

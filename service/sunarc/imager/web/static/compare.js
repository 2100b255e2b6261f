// Two calibrations compared over the sky: asked for when they are chosen, never before.
import { ask } from "./ask.js";
import { drawCells } from "./cells.js";
import { $, moment, node, telling, write } from "./draw.js";

const LEAST_DEG = 1e-6; // below it, rounding
const angle = (value) => telling(Math.abs(value) < LEAST_DEG ? 0 : value, "°");
const named = (one) => `${moment(one.created_at)} (${one.state})`;

export function offerComparison(calibrations) {
  const offered = calibrations.filter((one) => one.accepted);
  const ids = offered.map((one) => one.id).join();
  for (const [id, first] of [["compare-one", 0], ["compare-other", 1]]) {
    if ($(id).dataset.ids === ids) continue;
    const before = $(id).value;
    $(id).dataset.ids = ids;
    $(id).replaceChildren(...offered.map((one) => { const option = node("option", named(one)); option.value = one.id; return option; }));
    $(id).value = offered.some((one) => one.id === before) ? before : offered[first]?.id ?? "";
  }
  $("compare-form").hidden = offered.length < 2;
  if (offered.length < 2) write($("compare-sum"), "There is no second accepted calibration to compare with yet.");
  else if (!$("compare").hasChildNodes()) write($("compare-sum"), "");
}

export async function compare(overlay) {
  const [one, other] = [$("compare-one").value, $("compare-other").value];
  const answer = await ask(`/v1/difference?other=${encodeURIComponent(other)}&calibration=${encodeURIComponent(one)}`).catch(() => null);
  $("compare").toggleAttribute("hidden", !answer);
  $("compare-scale").toggleAttribute("hidden", !answer);
  if (!answer || answer.rms_deg === null) {
    write($("compare-sum"), "These two have no sky in common, or images of another size.");
    return;
  }
  const [east, north, up] = answer.rotation_deg.map(angle);
  write($("compare-sum"), `Directions differ by ${angle(answer.rms_deg)} RMS, ${angle(answer.max_deg)} at most. A rotation by ${east} about east, ${north} about north and ${up} about up explains all but ${angle(answer.rms_rotated_deg)} RMS.`);
  const size = [answer.x_px.at(-1) + answer.x_px[0] + 1, answer.y_px.at(-1) + answer.y_px[0] + 1];
  drawCells($("compare"), $("compare-scale"), { ...answer, rows: answer.difference_deg }, overlay, size);
}

// The map of 1-sigma over the image.
import { drawCells, span } from "./cells.js";
import { $, telling } from "./draw.js";

export function drawSigma(map, overlay, size) {
  $("sigma").toggleAttribute("hidden", !map);
  if (!map) {
    $("sigma-sum").textContent = "No calibration yet.";
    $("sigma-scale").replaceChildren();
    return;
  }
  const [least, middle, most] = span(map.sigma_deg);
  $("sigma-sum").textContent = `1-sigma per axis of view directions, degrees: ${telling(least)} at best, median ${telling(middle)}, ${telling(most)} at worst.`;
  drawCells($("sigma"), $("sigma-scale"), { ...map, rows: map.sigma_deg }, overlay, size ?? [1, 1]);
}

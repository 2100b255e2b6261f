// The map of 1-sigma over the image.
import { drawCells, span } from "./cells.js";
import { $, telling } from "./draw.js";

// The share of the sky within the limit, in whole per cent, never rounded up to all.
export const sharePercent = (map) => Math.floor(100 * map.share_within);
export const beyondText = (map) => `1-sigma of the rest is above ${telling(map.limit_deg)}°: sightings of other days and seasons, or of stars, make it less`;
const withinText = (map) => (map.share_within === null ? "" : `${sharePercent(map)} % of the sky within ${telling(map.limit_deg)}°.`);

export function drawSigma(map, overlay, size) {
  $("sigma").toggleAttribute("hidden", !map);
  if (!map) {
    $("sigma-sum").textContent = "No calibration yet.";
    $("sigma-scale").replaceChildren();
    return;
  }
  const [least, middle, most] = span(map.sigma_deg);
  $("sigma-sum").textContent = `${withinText(map)} 1-sigma per axis of view directions, degrees: ${telling(least)} at best, median ${telling(middle)}, ${telling(most)} at worst.`;
  drawCells($("sigma"), $("sigma-scale"), { ...map, rows: map.sigma_deg }, overlay, size ?? [1, 1]);
}

// The map of 1-sigma over the image.
import { drawCells, span } from "./cells.js";
import { $, telling, write } from "./draw.js";

// The share of the sky within the limit, in whole per cent, never rounded up to all.
export const sharePercent = (map) => Math.floor(100 * map.share_within);
export const beyondText = ({ limit_deg: limit, least_certain: part }) => `1-sigma is above ${telling(limit)}° ${part ? part.text : "in the rest"}`;
const withinText = (map) => (map.share_within === null ? "" : `${sharePercent(map)} % of the sky within ${telling(map.limit_deg)}°.`);

export function drawSigma(map, overlay, size) {
  $("sigma").toggleAttribute("hidden", !map);
  if (!map) {
    write($("sigma-sum"), "No calibration yet.");
    $("sigma-scale").replaceChildren();
    return;
  }
  const [least, middle, most] = span(map.sigma_deg);
  write($("sigma-sum"), `${withinText(map)} 1-sigma per axis of view directions, degrees: ${telling(least)} at best, median ${telling(middle)}, ${telling(most)} at worst.`);
  drawCells($("sigma"), $("sigma-scale"), { ...map, rows: map.sigma_deg }, overlay, size ?? [1, 1]);
}

// What a pixel of the sky looks at, and where a cloud is that it shows, as the API says.
import { ask } from "./ask.js";
import { $, fillFacts, fixed, telling } from "./draw.js";

const place = (found) => (found.latitude[0] === null ? "none: at or below the horizon"
  : `${found.latitude[0].toFixed(5)}° N, ${found.longitude[0].toFixed(5)}° E, ± ${telling(found.sigma_m[0], " m")} (${telling(found.east_m[0], " m")} east, ${telling(found.north_m[0], " m")} north)`);

// Ask for the pixel in the form; null where nothing is known of it.
export async function lookUp() {
  const pixel = [$("ask-x").valueAsNumber, $("ask-y").valueAsNumber];
  const height = $("ask-height").valueAsNumber;
  if (![...pixel, height].every(Number.isFinite)) return null;
  const [looks, places] = await Promise.all([
    ask("/v1/back-project", { pixels: [pixel] }), ask("/v1/geolocate", { pixels: [pixel], height_m: height }),
  ]).catch(() => [null, null]);
  const seen = looks && looks.zenith_deg[0] !== null;
  fillFacts("asked", {
    Pixel: pixel.map((value) => value.toFixed(1)).join(", "),
    Direction: !looks ? "no calibration, or no answer"
      : seen ? `zenith angle ${fixed(looks.zenith_deg[0], 3, "°")}, azimuth ${fixed(looks.azimuth_deg[0], 3, "°")} ± ${telling(looks.sigma_deg[0], "°")}${looks.inside[0] ? "" : " (outside the camera's field)"}`
        : "none: outside the camera's field",
    ...(seen ? { [`Cloud at ${telling(height, " m")}`]: place(places.cloud), "Its shadow": places.shadow.latitude[0] === null ? "none: no sun, or no cloud" : place(places.shadow) } : {}),
  });
  return pixel;
}

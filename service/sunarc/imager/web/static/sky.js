// The latest image, and over it what the calibration says of the sky. All geometry comes from /v1/overlay.
import { askImage } from "./ask.js";
import { $, element, label, mark, path, zoned } from "./draw.js";

const EXPECTED = "M0-4.4V-2M0 4.4V2M-4.4 0H-2M4.4 0H2M2.7 0A2.7 2.7 0 1 1-2.7 0A2.7 2.7 0 1 1 2.7 0";
const SEEN = "M0-1.5L1.5 0L0 1.5L-1.5 0Z";

const ASKED = "M-3 0H-1M1 0H3M0-3V-1M0 1V3";
const THUMBNAIL_PX = 640;
const IMAGE_EVERY_MS = 600000;
const DARK_DEG = -12; // of the sun's elevation: the end of nautical twilight
let shownAt = -Infinity;
let takenAt = null;
let enlarged = false;

// The preview as a thumbnail, at most once in ten minutes: it is most of that the page loads.
export async function showImage(status) {
  const stamp = status.last_frame_at ?? "none since the start";
  const image = $("image");
  if (image.dataset.stamp === stamp || Date.now() - shownAt < IMAGE_EVERY_MS) return;
  image.dataset.stamp = stamp;
  shownAt = Date.now();
  const found = await askImage(`/v1/image/latest?width=${enlarged ? Math.min(4096, status.image_size?.[0] ?? THUMBNAIL_PX) : THUMBNAIL_PX}`);
  if (!found) return;
  const { address } = found;
  takenAt = found.time;
  const next = new Image();
  next.src = address;
  await next.decode();
  const before = image.src;
  image.src = address;
  image.hidden = false;
  $("no-image").hidden = true;
  if (before) URL.revokeObjectURL(before);
}

// What is observed while the sun is not, and when it is next, in a sentence; empty while it is.
export function skyText({ sky, camera, timezone, state }) {
  if (sky.observed === "sun") return "";
  const [down, at] = [Math.abs(sky.sun_elevation_deg).toFixed(0), (time) => zoned(time, timezone, 16)];
  const name = sky.sun_elevation_deg > DARK_DEG ? "Twilight" : "Night";
  const begin = `${name} at the camera, the sun ${down}° ${sky.sun_elevation_deg > 0 ? "above" : "below"} the horizon`;
  const next = sky.sun_from ? `the next image with the sun is expected at ${at(sky.sun_from)}` : "the sun does not rise within 200 days";
  if (state === "not_serving" || camera?.connected === false) return `${begin}; ${next}.`;
  if (sky.observed === "stars") return `${begin}: stars are observed until dawn; ${next}.`;
  const stars = sky.stars_from && (!sky.sun_from || sky.stars_from < sky.sun_from);
  return `${begin}: nothing is observed until ${stars ? `the stars at ${at(sky.stars_from)}; ${next}` : sky.sun_from ? `the next image with the sun, expected at ${at(sky.sun_from)}` : next}.`;
}

// When the picture that is shown was taken; null where that is not known.
export const pictureTime = () => takenAt;

// The part [x, y, width, height] of the image that is shown; enlarged it is loaded in full, once and with what comes.
export function showPart([x, y, width, height], factor, status) {
  const [across, down] = [((x + 0.5) / width) * 100, ((y + 0.5) / height) * 100];
  for (const id of ["image", "mask"]) $(id).style.transform = `translate(${-across}%, ${-down}%) scale(${factor})`;
  if (factor <= 1 || enlarged || !status) return;
  enlarged = true;
  delete $("image").dataset.stamp;
  shownAt = -Infinity;
  showImage(status).catch(() => {});
}

// N, E, S, W just inside the horizon, where it is in the image.
export function compass(overlay) {
  return (overlay?.azimuth_lines ?? []).filter((line) => line.name).map((line) => {
    const seen = line.pixels.filter(Boolean);
    return [line.name, seen.at(-2) ?? seen.at(-1)];
  }).filter(([, at]) => at);
}

// Marks and names have the size of the part that is shown, not of the image. `expected` and `seen` are pixels of one moment.
export function drawSky(size, part, overlay, { expected, seen }, asked, way = []) {
  const [width, height] = size ?? [1, 1];
  const u = part[2] / 100;
  $("overlay").setAttribute("viewBox", part.join(" "));
  $("picture").style.setProperty("aspect-ratio", `${width} / ${height}`);
  const parts = [];
  for (const line of overlay?.azimuth_lines ?? []) parts.push(element("path", { class: line.name ? "azimuth named" : "azimuth", d: path(line.pixels) }));
  for (const circle of overlay?.zenith_circles ?? []) parts.push(element("path", { class: circle.zenith_deg === 90 ? "horizon" : "azimuth", d: path(circle.pixels) }));
  for (const way of overlay?.sun_paths ?? []) parts.push(...drawPath(way, u));
  for (const [name, at] of compass(overlay)) parts.push(label(at, name, u * 4, "corner"));
  if (way.length > 1) parts.push(element("path", { class: "first-way", d: path(way) }));
  if (seen) parts.push(mark(SEEN, "seen", seen, u));
  if (expected) for (const style of ["expected-under", "expected"]) parts.push(mark(EXPECTED, style, expected, u));
  if (asked) for (const style of ["expected-under", "asked"]) parts.push(mark(ASKED, style, asked, u));
  $("overlay").replaceChildren(...parts);
}

function drawPath(way, u) {
  const parts = [element("path", { class: way.name === "today" ? "track" : "solstice", d: path(way.pixels) })];
  if (way.name !== "today") return parts;
  way.time.forEach((time, k) => {
    const at = way.pixels[k];
    if (!at || !/T\d\d:00:00/.test(time)) return;
    parts.push(element("circle", { class: "hour", cx: at[0], cy: at[1], r: u * 0.7 }));
    if (Number(time.slice(11, 13)) % 2 === 0) parts.push(label([at[0], at[1] - u * 2], `${time.slice(11, 13)}h`, u * 2.8, "hour-name"));
  });
  return parts;
}

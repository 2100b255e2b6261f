// The nights: the picture of one with what is named in it, its numbers, and the course of all.
import { ask, askImage } from "./ask.js";
import { $, element, fillFacts, fixed, label, mark, moment, node, sentences, telling, write } from "./draw.js";
import { DAY_MS, drawSeries } from "./plots.js";

export const NIGHT_SIGNS = { clear: "★", partly: "☆", cloudy: "☁", moonlit: "☾", unusable: "✕" };
const RING = "M1.6 0A1.6 1.6 0 1 1-1.6 0A1.6 1.6 0 1 1 1.6 0"; // detected
const CROSS = "M-1.5-1.5L-0.5-0.5M1.5 1.5L0.5 0.5M1.5-1.5L0.5-0.5M-1.5 1.5L-0.5 0.5"; // predicted, and not detected
const SQUARE = "M-1.8-1.8H1.8V1.8H-1.8Z"; // the moon, or an image in which no star was named
const NEAR = 0.06; // of the picture's width: how far from a body a pointer may be
const known = { nights: [], pose: null, night: null, bodies: null, body: null, picture: "", drawn: "" };

export const nightOf = (date) => known.nights.find((night) => night.night === date);

export async function readNights() {
  ({ nights: known.nights, pose: known.pose } = await ask("/v1/nights?limit=366"));
  $("night").hidden = !known.nights.length;
  if (!known.nights.length) return known.nights;
  drawCourse();
  await showNight(nightOf(known.night)?.night ?? known.nights[0].night);
  return known.nights;
}

// One night; its picture and names are asked for once, and again when it was judged anew.
export async function showNight(date) {
  const night = nightOf(date);
  if (!night) return;
  const stamp = `${date} ${night.decided_at}`;
  const before = known.drawn;
  [known.night, known.drawn] = [date, stamp];
  $("night-title").textContent = `Night of ${date}`;
  fillFacts("night-facts", factsOf(night));
  if (stamp === before) return;
  known.bodies = null;
  known.body = null;
  drawBodies();
  const pictured = night.picture ? [askImage(`/v1/nights/${date}/image`), ask(`/v1/nights/${date}/bodies`)] : [null, null];
  const found = await Promise.all([...pictured, imagesOf(night)]);
  if (known.drawn !== stamp) return;
  await showPicture(found[0]);
  known.bodies = found[1];
  drawBodies();
  drawImages(found[2]);
}

async function imagesOf(night) {
  const until = new Date(Date.parse(night.decided_at) + 1000).toISOString();
  const found = await ask(`/v1/nights?images=true&since=${encodeURIComponent(night.decided_at)}&until=${encodeURIComponent(until)}`);
  return found.nights.find((one) => one.night === night.night)?.images ?? null;
}

function factsOf(night) {
  const verdict = document.createElement("span");
  const why = night.findings.filter((one) => one.code !== "night_images"); // its counts stand below
  verdict.append(`${NIGHT_SIGNS[night.verdict]} ${night.verdict}${why.length ? ": " : ""}`, sentences(why.map((one) => one.code.replaceAll("_", " ")), why));
  const facts = { Verdict: verdict };
  if (night.n_accepted) Object.assign(facts, starFacts(night));
  else facts.Images = `${night.n_images}, without identified stars`;
  if (night.n_moon_images) facts.Moon = `${night.n_moon_stored} sightings in ${night.n_moon_images} slots`;
  if (night.n_warm_pixels) facts["Warm pixels"] = `${night.n_warm_pixels}, repaired`;
  if (known.pose) facts["Pose at night"] = `turned by ${axes(known.pose.pose_difference_deg)}° about east, north and up against the day, 1-sigma ${axes(known.pose.pose_sigma_deg)}° (all nights of the calibration)`;
  return facts;
}

// Of a night in which stars were named; what is not known is left out.
function starFacts(night) {
  const sky = [`limiting magnitude ${telling(night.limiting_magnitude)}`, `clouds ${percent(night.cloud_fraction)}`];
  if (night.extinction !== null) sky.push(`extinction ${telling(night.extinction)} ± ${telling(night.extinction_sigma)} mag an air mass`);
  const lens = [`stars ${fixed(night.star_fwhm_px, 2, " px")} wide`];
  if (night.star_ellipticity !== null) lens.push(`ellipticity ${telling(night.star_ellipticity)}`);
  if (night.width_growth !== null) lens.push(`over the night ${telling(night.width_growth)} times as wide`);
  if (night.fading_mag !== null) lens.push(`${telling(Math.abs(night.fading_mag))} mag ${night.fading_mag < 0 ? "brighter" : "fainter"} at its end`);
  const bands = night.zenith_bands.filter((band) => band.transparency !== null);
  const facts = {
    Stars: `${night.n_matched} identified of ${night.n_stars} in an image, in ${night.n_accepted} of ${night.n_images} images; ${night.n_stored} sightings`,
    Sky: sky.join(", "),
  };
  if (bands.length) facts["Light by zenith angle"] = bands.map((band) => `${band.from_deg.toFixed(0)}–${band.to_deg.toFixed(0)}°: ${percent(band.transparency)}`).join(", ");
  return { ...facts, Lens: lens.join(", ") };
}

const axes = (values) => values.map((value) => value.toFixed(4)).join(", ");

const percent = (share) => (share === null || share === undefined ? "–" : `${(100 * share).toFixed(0)} %`);

async function showPicture(found) {
  const image = $("night-image");
  if (known.picture) URL.revokeObjectURL(known.picture);
  known.picture = found?.address ?? "";
  $("night-picture").hidden = !found;
  image.hidden = !found;
  if (!found) return;
  image.src = found.address;
  await image.decode();
}

const size = () => known.bodies?.image_size ?? [$("night-image").naturalWidth || 1, $("night-image").naturalHeight || 1];

// Rings about what was detected, crosses where a star was predicted and not found; the one that is chosen has its name.
function drawBodies() {
  const [width, height] = size();
  const unit = width / 100;
  $("night-overlay").setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  $("night-picture").style.setProperty("aspect-ratio", `${width} / ${height}`);
  const bodies = known.bodies?.bodies ?? [];
  const parts = bodies.map((one) => mark(shapeOf(one), styleOf(one), one.pixel, unit * (one.magnitude < 1.5 ? 1.1 : 0.7)));
  const others = bodies.filter((one) => !one.body.startsWith("star:") && one !== known.body);
  for (const one of others) parts.push(named(one, unit, height));
  if (known.body) parts.push(mark(RING, "night-chosen", known.body.pixel, unit * 1.8), named(known.body, unit, height));
  $("night-overlay").replaceChildren(...parts);
  const choices = [option("", "none"), ...[...bodies].sort((a, b) => a.title.localeCompare(b.title, "en", { numeric: true })).map((one) => option(one.body, one.title))];
  if ($("night-body").dataset.of !== known.drawn + bodies.length) $("night-body").replaceChildren(...choices);
  $("night-body").dataset.of = known.drawn + bodies.length;
  $("night-body").value = known.body?.body ?? "";
  $("night-legend").hidden = !bodies.length;
  $("night-said").hidden = !known.picture;
  write($("night-said"), known.body ? describe(known.body) : summary(bodies));
}

function summary(bodies) {
  const stars = bodies.filter((one) => one.found !== null);
  const at = known.bodies ? ` at ${moment(known.bodies.time).slice(0, 16)}` : "";
  return stars.length ? `${stars.filter((one) => one.found).length} of ${stars.length} bright stars and planets detected${at}.` : `The image with the most detections${at}; no star is identified in it.`;
}

const option = (value, text) => { const made = node("option", text); made.value = value; return made; };
const shapeOf = (one) => (one.found === null ? SQUARE : one.found ? RING : CROSS);
const styleOf = (one) => (one.found === null ? "night-other" : one.found ? "night-found" : "night-missed");

function named(one, unit, height) {
  const above = one.pixel[1] > height * 0.08;
  return label([one.pixel[0], one.pixel[1] + (above ? -3 : 4) * unit], one.title, unit * 3, "corner");
}

function describe(one) {
  const lit = one.lit === null ? "" : `, ${percent(one.lit)} lit`;
  const state = one.found === null ? "predicted there" : one.found ? "detected" : "predicted there, not detected";
  return `${one.title}${one.title.startsWith("HIP") || !one.body.startsWith("star:") ? "" : ` (${one.body.replace("star:HIP", "HIP ")})`}: magnitude ${telling(one.magnitude)}${lit}, ${state}, at x ${one.pixel[0].toFixed(0)}, y ${one.pixel[1].toFixed(0)} px.`;
}

function choose(body) {
  if (body === known.body) return;
  known.body = body;
  drawBodies();
}

// The body nearest to a pointer.
function nearest(event) {
  const frame = $("night-picture").getBoundingClientRect();
  const [width, height] = size();
  const [x, y] = [((event.clientX - frame.left) / frame.width) * width, ((event.clientY - frame.top) / frame.height) * height];
  const far = (one) => Math.hypot(one.pixel[0] - x, one.pixel[1] - y);
  const best = (known.bodies?.bodies ?? []).reduce((least, one) => (least === null || far(one) < far(least) ? one : least), null);
  return best && far(best) < NEAR * width ? best : null;
}

function drawImages(images) {
  const rows = (images?.time ?? []).map((time, k) => [Date.parse(time), images.limiting_magnitude[k], images.cloud_fraction[k]]);
  $("night-images").hidden = rows.length < 2;
  if (rows.length < 2) return;
  drawSeries("night-limits", [["x-mark", rows.filter((row) => row[1] !== null).map((row) => [row[0], row[1]])]], 0);
  drawSeries("night-clouds", [["y-mark", rows.filter((row) => row[2] !== null).map((row) => [row[0], 100 * row[2]])]], 0);
}

// Of all nights; those without a number are left out.
function drawCourse() {
  const rows = known.nights.map((night) => [Date.parse(night.night), night.limiting_magnitude, night.cloud_fraction]);
  const limits = rows.filter((row) => row[1] !== null);
  $("nights-course").hidden = limits.length < 2;
  if (limits.length < 2) return;
  drawSeries("nights-limits", [["x-mark", limits.map((row) => [row[0], row[1]])]], DAY_MS);
  drawSeries("nights-clouds", [["y-mark", rows.filter((row) => row[2] !== null).map((row) => [row[0], 100 * row[2]])]], DAY_MS);
}

$("night-body").addEventListener("change", () => choose(known.bodies?.bodies.find((one) => one.body === $("night-body").value) ?? null));
for (const kind of ["pointermove", "pointerdown"]) $("night-picture").addEventListener(kind, (event) => { const one = nearest(event); if (one || kind === "pointerdown") choose(one); });

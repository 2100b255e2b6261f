// The first hours of a camera: whether the sun was found, what to check, how sure the north is, and when a fit can be expected.
import { $, ago, fillFacts, fixed, moment, node, telling, zoned, write } from "./draw.js";
import { DAY_MS, drawSeries } from "./plots.js";

const MS_PER_DEGREE = 240000; // of longitude: the sun's mean rate
const MOST_POINTS = 1000;
const NIGHT_MS = 10800000; // without a sighting: the way since then is shown
const LEAST_TURN_DEG = 10; // below, which way the sun goes round the middle is not said
const OF_FEW = "first_pose_provisional";
const POINTS = ["north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west"];

const finding = (status, code) => status.findings.find((one) => one.code === code)?.data;
const sum = (counts, of) => counts.reduce((all, day) => all + of(day), 0);

export const isFirst = (status) => Boolean(status) && (!status.calibration || finding(status, OF_FEW) !== undefined);

// The first sightings of the present epoch, the oldest first, as pixels: where the sun went through the image.
export const firstWay = (status, points) => (isFirst(status) ? found(points).map((point) => [point.x_px, point.y_px]) : []);

const found = (points) => points.filter((point) => point.accepted && point.x_px !== null && point.pose_epoch === points[0].pose_epoch).reverse();

export function drawFirst({ status, points, residualsBy, counts, calibrations, overlay, sun }, site) {
  $("first").hidden = !isFirst(status);
  if ($("first").hidden) return;
  const pose = finding(status, OF_FEW);
  $("first-title").textContent = pose ? "First hours: a provisional pose" : "First hours: no calibration yet";
  const sightings = found(points);
  const today = overlay?.sun_paths.find((way) => way.name === "today");
  fillFacts("first-facts", {
    "Sun in the image": residualsBy === undefined ? "…" : ofSun(status, sightings, counts),
    "Its path": ofWay(status, sightings, today),
    North: ofNorth(status, pose, sightings.length),
    "First full fit": ofFit(status, sightings, today, site),
  });
  $("first-checks").replaceChildren(...checks(status, sun, site, sightings.length > 0).map(([good, text]) => {
    const item = node("li", "", good ? "good" : "warn");
    const sign = node("span", good === null ? "?" : good ? "✓" : "!");
    if (good === null) item.className = "";
    item.append(sign, node("span", ` ${text}`, "plain"));
    return item;
  }));
  drawNorth(calibrations, sightings[0]?.pose_epoch);
}

function ofSun(status, sightings, counts) {
  const looks = sum(counts, (day) => Object.values(day.verdicts).reduce((all, n) => all + n, 0));
  if (!sightings.length) return looks ? `not yet: in none of ${looks} images (${verdicts(counts)})` : `not yet: ${unseen(status)}`;
  const [first, last] = [sightings[0], sightings.at(-1)];
  const at = (point) => `x ${point.x_px.toFixed(0)}, y ${point.y_px.toFixed(0)} px`;
  const n = sightings.length >= MOST_POINTS ? `at least ${MOST_POINTS}` : sightings.length;
  return `found ${n} times, first at ${moment(first.time)} (${at(first)}), last ${ago(last.time, status.frame_time)} (${at(last)})`;
}

// Why the sun was looked for in no image: none came, the sun is down, or the first is still to be evaluated.
function unseen({ last_frame_at: last, started_at: start, sky, timezone, frame_time: now }) {
  if (sky.observed !== "sun") return `the sun is down; the first image with the sun is expected ${sky.sun_from ? `at ${zoned(sky.sun_from, timezone, 16)}` : "after the polar night"}`;
  if (!last) return `no image has come from the camera since the service started (${ago(start, now)})`;
  return `images come (the last ${ago(last, now)}), none of them was evaluated for the sun yet`;
}

function verdicts(counts) {
  const all = {};
  for (const day of counts) for (const [verdict, n] of Object.entries(day.verdicts)) all[verdict] = (all[verdict] ?? 0) + n;
  return Object.entries(all).sort(([, a], [, b]) => b - a).map(([verdict, n]) => `${n} ${verdict}`).join(", ");
}

// Seen from below, the azimuth runs counter-clockwise in an image; in a mirrored one clockwise. The middle of the image is
// near the zenith of a camera that looks up: where the sun goes round it by about as much as its azimuth does, that counts.
function ofWay(status, every, today) {
  const night = every.findLastIndex((point, k) => k > 0 && Date.parse(point.time) - Date.parse(every[k - 1].time) > NIGHT_MS);
  const sightings = every.slice(Math.max(night, 0));
  const [width, height] = status.image_size ?? [1, 1];
  const turned = turn(sightings.map((point) => [Date.parse(point.time), Math.atan2(point.y_px - height / 2, point.x_px - width / 2) * (180 / Math.PI)]));
  if (Math.abs(turned) < LEAST_TURN_DEG) return "not yet long enough to show its sense of rotation about the image's centre";
  const way = turned > 0 ? "clockwise" : "counter-clockwise";
  const said = `${way} about the image's centre, by ${Math.abs(turned).toFixed(0)}°`;
  const expected = azimuthTurn(sightings, today);
  if (expected === null || Math.abs(expected) < LEAST_TURN_DEG) return said;
  const right = expected > 0 ? "counter-clockwise" : "clockwise";
  return `${said}; in an image that is not mirrored it moves ${right}, by about ${Math.abs(expected).toFixed(0)}°${way === right ? "" : ": compare with calibration.mirrored"}`;
}

// How far an angle turned, degrees, from [time, angle] in their order.
function turn(rows) {
  let all = 0;
  for (let k = 1; k < rows.length; k += 1) all += ((((rows[k][1] - rows[k - 1][1]) % 360) + 540) % 360) - 180;
  return all;
}

function azimuthTurn(sightings, today) {
  if (!today || sightings.length < 2) return null;
  const [from, to] = [Date.parse(sightings[0].time), Date.parse(sightings.at(-1).time)];
  const rows = today.time.map((time, k) => [Date.parse(time), today.azimuth[k]]).filter(([at]) => at >= from && at <= to);
  return Date.parse(today.time[0]) <= from && rows.length > 1 ? turn(rows) : null; // of today alone
}

function ofNorth(status, pose, n) {
  if (pose) {
    return `± ${telling(pose.north_sigma_deg)}° (1-sigma) after ${pose.n} sightings; the top of the image looks towards azimuth ${pose.top_azimuth_deg.toFixed(0)}°, ${compassPoint(pose.top_azimuth_deg)}. 1-sigma of directions ${telling(pose.sigma_deg)}°.`;
  }
  const waiting = finding(status, "first_sun");
  if (waiting) return `not known yet: ${waiting.n} of ${waiting.least} sightings that a first pose needs`;
  const refused = status.reasons.find((reason) => reason.code === "first_pose_refused");
  if (refused) return `not known: ${refused.text}`;
  return n ? "not known before the first full fit: the type of lens is not known (set first_pose.lens_prior)" : "not known yet";
}

const compassPoint = (azimuth) => POINTS[Math.round(azimuth / 45) % 8];

// A day is evaluated when it has ended, by local mean solar time.
function ofFit(status, sightings, today, site) {
  if (!today || !site) return "not known yet";
  const end = Date.parse(today.date) + DAY_MS - site.longitude * MS_PER_DEGREE;
  const written = (at) => zoned(new Date(at).toISOString(), status.timezone, 16);
  const set = today.time.at(-1);
  const over = !set || set <= status.frame_time;
  const shown = sightings.some((point) => point.time >= (today.time[0] ?? "9"));
  if (over && !shown) return `after the next clear day; at the earliest at ${written(end + DAY_MS)}`;
  const dusk = over ? "the sun has set" : `the sun sets at ${written(Date.parse(set))}`;
  return `${dusk}; the day is evaluated at ${written(end)}, and fitted if it showed enough of the sun's path; if it was cloudy, after the next clear day.`;
}

// What a person can compare, with ✓ or ! where the service knows.
function checks(status, sun, site, isMarked) {
  const { clock, camera } = status;
  const list = [[camera?.connected ?? null, camera?.connected ? `camera: ${[camera.model, camera.serial].filter(Boolean).join(", ") || "connected"}` : camera ? "camera: not connected" : "camera: not known yet"]];
  const synchronised = clock?.synchronised ?? null;
  list.push([synchronised, synchronised ? `clock: synchronised, within ${telling(clock.max_error_s)} s` : synchronised === null ? "clock: synchronisation unknown" : "clock: not synchronised; an error of 4 minutes turns north by 1° or more"]);
  if (site && sun) {
    const up = sun.apparent_zenith < 90;
    list.push([null, `clock and site: at ${degrees(site.latitude, "N", "S")}, ${degrees(site.longitude, "E", "W")} the sun is now ${up ? `${fixed(90 - sun.apparent_zenith, 0, "°")} above the horizon in the ${compassPoint(sun.azimuth)}` : "below the horizon"}: compare with the sky`]);
  }
  const mark = isMarked ? "the mark is on the sun, not on a reflection or a lamp; " : "";
  if (status.last_frame_at) list.push([null, `image: ${mark}the horizon is visible all round`]);
  const refused = status.reasons.find((reason) => reason.code === "first_pose_refused");
  list.push(refused ? [false, `mounting: ${refused.text}; ${refused.remedy}`] : [finding(status, OF_FEW) ? true : null, finding(status, OF_FEW) ? "mounting: not mirrored, and only one azimuth of north fits; compare the top of the image with a map" : "mounting: the camera is level, its image not mirrored (or calibration.mirrored says so)"]);
  return list;
}

const degrees = (value, positive, negative) => `${Math.abs(value).toFixed(2)}° ${value < 0 ? negative : positive}`;

// How sure the north was by each first pose.
function drawNorth(calibrations, epoch) {
  const series = calibrations.filter((one) => !epoch || one.pose_epoch === epoch).flatMap((one) => one.findings
    .filter((each) => each.code === "first_pose").map((each) => [Date.parse(one.created_at), each.data.north_sigma_deg])).sort(([a], [b]) => a - b);
  $("first-north").toggleAttribute("hidden", series.length < 2);
  $("first-north-sum").hidden = series.length < 2;
  if (series.length < 2) return;
  write($("first-north-sum"), `1-sigma of north, degrees: ${telling(series[0][1])} at the first pose, ${telling(series.at(-1)[1])} at the last`);
  drawSeries("first-north", [["x-mark", series]], 0);
}

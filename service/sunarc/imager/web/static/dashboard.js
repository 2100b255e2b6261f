// The dashboard: asks the API, draws what it says, and asks again.
import { ask, keepToken, listen, NeedsToken } from "./ask.js";
import { drawCalendar } from "./calendar.js";
import { $, ago, fillFacts, fillRows, fixed, judged, moment, node, sentences, telling, write, zoned } from "./draw.js";
import { compare, offerComparison } from "./compare.js";
import { drawFirst, firstWay } from "./first.js";
import { drawHistory, spanDays } from "./history.js";
import { readHorizon, showMask } from "./horizon.js";
import { lookUp } from "./lookup.js";
import { concerns, drawMoves } from "./moves.js";
import { readNights } from "./night.js";
import { drawResiduals } from "./residuals.js";
import { beyondText, drawSigma, sharePercent } from "./sigma.js";
import { drawSky, pictureTime, showImage, showPart, skyText } from "./sky.js";
import { Zoom } from "./zoom.js";

const SIGNS = { ready: ["✓", "Ready"], ready_with_note: ["✓", "Ready, with a note"], starting: ["…", "Starting"], attention: ["!", "Attention"], not_serving: ["✕", "Not serving"], gone: ["✕", "No answer"], locked: ["!", "Locked"] };
const SHOWN_ELSEWHERE = ["health", "state", "state_text", "notes", "pose", "reasons", "findings", "version", "camera_name", "frame_time", "workers", "calibration", "last_day", "image_size", "is_replay", "timezone", "obstructions", "sky"];
const CONDITION_SIGNS = { note: "i", degraded: "!", not_ready: "✕" };
const OF_POSE_ALONE = ["provisional_pose", "first_pose_provisional"];
const NO_ACTION = "none"; // as docs/codes.md has it
const MOST_POINTS = 1000;
const SAME_MS = 60000; // a sighting of the picture's cycle
const MOST_ROWS = 50; // of the table of calibrations; the plot has more
// What the stream of events does not tell: how old heartbeats are, how the sun moved, what was sighted.
const STATUS_MS = 60000;
const SKY_MS = 30000;
const RESIDUALS_MS = 60000;
const RECORD_MS = 3600000;
const FRESH_MS = 5000;
const LEAST_SHARE = 0.5; // of the sky within the limit, below which a ready camera is shown as one to attend to
const LEAST_CLOCK_S = 0.5; // of a clock's error, from which on it is named with the pixel
const MORE_EVENTS = 50;
const MOST_EVENTS = 1000;
const CALENDAR_DAYS = 182;
const COUNTED_DAYS = 366; // as many as are counted at once
const MOST_HOURLY_DAYS = 31; // of longer spans housekeeping is shown by day
const known = {
  status: null, moves: [], points: [], calibrations: [], days: [], nights: [], counts: [], housekeeping: { step: "hour", rows: [] },
  overlay: null, sun: null, sunInPicture: null, uncertainty: null, asked: null, site: null, calibration: undefined, residualsBy: undefined, hour: null, events: MORE_EVENTS, kinds: new Set(),
};

function showHealth(health, headline, stateText = "") {
  const share = known.uncertainty?.share_within ?? 1;
  const plain = SIGNS[health][1];
  const shown = share < LEAST_SHARE && health.startsWith("ready") ? "attention" : health;
  const [sign] = SIGNS[shown];
  const inPart = share < 1 && health.startsWith("ready");
  const word = inPart ? plain.replace("Ready", `Ready for ${sharePercent(known.uncertainty)} % of the sky`) : plain;
  write($("state-text"), [stateText, inPart ? beyondText(known.uncertainty) : ""].filter(Boolean).join("; "));
  write($("sky-now"), known.status && !["gone", "locked"].includes(health) ? skyText(known.status) : "");
  write($("improves"), (inPart && known.uncertainty.least_certain?.remedy) || "");
  $("health").dataset.health = shown;
  $("health-sign").textContent = sign;
  write($("health-word"), word);
  write($("headline"), headline);
  document.title = `${sign} ${word} · ${known.status?.camera_name ?? ""} · sunarc`;
}

async function refreshStatus() {
  const status = await ask("/v1/status");
  known.status = status;
  $("token-form").hidden = true;
  $("camera-name").textContent = `· ${status.camera_name}`;
  $("version").textContent = `sunarc ${status.version}`;
  $("replay").hidden = !status.is_replay;
  write($("replay"), status.is_replay ? `▶ replay: its clock shows ${zoned(status.frame_time, status.timezone)}` : "");
  const c = status.calibration;
  const conditions = [...status.reasons, ...status.notes].sort((one, other) => Number(other.text === status.state_text) - Number(one.text === status.state_text));
  const has = (...codes) => conditions.some(({ code }) => codes.includes(code));
  const uncertain = has("lens_changed") ? "before the change of the lens" : c && `direction uncertainty ${telling(c.sky_rms_deg, "°")}`;
  const quality = c ? `${has(...OF_POSE_ALONE) ? "pose estimated" : "calibrated"} ${ago(c.created_at, status.frame_time)}, ${uncertain}` : known.calibrations.length ? "no calibration serves" : "not calibrated yet";
  const seen = status.last_sighting_at ? `last sighting ${ago(status.last_sighting_at, status.frame_time)}` : "no sighting yet";
  showHealth(status.state, [...lastClearDay(), quality, seen].join(" · "), status.state === "ready" ? "" : status.state_text + stillText(status));
  const elsewhere = (one) => known.moves.some(({ id }) => concerns(one, id)); // with the event, on top
  $("reasons").replaceChildren(...conditions.filter((one) => !elsewhere(one)).map(condition));
  fillRows("workers", status.workers.map((w) => [
    w.name, judged(waits(w, status) ? "waiting for the camera" : w.state), fixed(w.heartbeat_age_s, 0, " s ago"), w.last_error ? `${w.restarts} (${w.last_error})` : String(w.restarts),
  ]), "No worker has started.");
  fillFacts("facts", factsOf(status));
  fillFacts("more-facts", moreFactsOf(status));
  redrawFirst();
  await showImage(status);
  await refreshPicture();
}

// The sun at the time of the picture, by the calibration that is current.
async function refreshPicture() {
  const time = pictureTime();
  const by = known.status?.calibration?.id ?? null;
  const before = known.sunInPicture;
  if (!time || (before?.time === time && before.by === by)) return;
  const chosen = by ? `&calibration=${encodeURIComponent(by)}` : "";
  const sun = await ask(`/v1/sun?at=${encodeURIComponent(time)}${chosen}`).catch(() => null);
  known.sunInPicture = { time, by, sun };
  showSun();
}

// What a service that is not serving does all the same.
function stillText({ state, calibration, camera }) {
  if (state !== "not_serving") return "";
  const frames = camera?.connected === false ? "; no new frames come" : "";
  return calibration ? `${frames}; directions are answered with the last calibration` : frames;
}

// The newest clear day and by how much the camera's pose was off on it, where the record is known.
function lastClearDay() {
  const clear = known.days.find((day) => day.verdict === "clear");
  if (!clear) return known.days.length ? ["no clear day yet"] : [];
  const off = clear.pose_offset_deg, sigma = clear.pose_offset_sigma_deg;
  const moved = off === null ? "" : off > 3 * (sigma ?? 0) ? `, pose off by ${telling(off, "°")}` : ", pose as calibrated";
  return [`last clear day ${clear.date}${moved}`];
}

// A condition: what is the case, what to do where there is something to do, and the code under which it is documented.
function condition({ code, severity, text, remedy, since }) {
  const item = node("li");
  item.dataset.code = code;
  item.dataset.severity = severity;
  const sign = known.status?.state === "starting" ? "…" : CONDITION_SIGNS[severity];
  const isInHeader = remedy !== NO_ACTION && text === known.status?.state_text;
  item.append(node("b", isInHeader ? sign : `${sign} ${text}.`));
  if (remedy !== NO_ACTION) item.append(node("span", `What to do: ${remedy}. `, "action"));
  if (since) item.append(node("small", `since ${moment(since)} `));
  item.append(node("code", code));
  return item;
}

// The thread of exposures runs on while the camera does not answer: it opens the camera again.
const waits = (worker, { camera }) => worker.name === "capture" && worker.state === "running" && camera?.connected === false;

function factsOf(status) {
  const { camera, clock } = status;
  const facts = {
    Camera: camera ? `${camera.connected ? "✓ connected" : "✕ not connected"} ${[camera.model, camera.serial, camera.address].filter(Boolean).join(", ")}` : "not known yet",
    Pose: status.pose ? `${status.pose.text} (φxz ${fixed(status.pose.phi_xz_deg, 2)}°, θzz ${fixed(status.pose.theta_zz_deg, 2)}°, ψz ${fixed(status.pose.psi_z_deg, 1)}°)` : "not known yet",
    "Last frame": `${moment(status.last_frame_at)} (${ago(status.last_frame_at, status.frame_time)})`,
    "Last sighting": `${moment(status.last_sighting_at)} (${ago(status.last_sighting_at, status.frame_time)})`,
    Clock: clock && clock.synchronised !== null ? `${clock.synchronised ? "✓ synchronised" : "! not synchronised"}${clock.max_error_s === null ? "" : `, within ${telling(clock.max_error_s)} s`}` : "not known yet",
    "Disk free": status.disk_free_bytes === null ? "not known yet" : bytes(status.disk_free_bytes),
    "Running since": moment(status.started_at),
    "Time now": `${zoned(status.frame_time, status.timezone)}${status.is_replay ? ", of a replay" : ""}`,
  };
  return facts;
}

function moreFactsOf(status) {
  const facts = {};
  const shown = [...SHOWN_ELSEWHERE, "camera", "clock", "last_frame_at", "last_sighting_at", "disk_free_bytes", "started_at"];
  for (const [name, value] of Object.entries(status)) if (!shown.includes(name) && value !== null) addFact(facts, name, value);
  return facts;
}

const bytes = (count) => (count >= 1e9 ? `${telling(count / 1e9)} GB` : `${telling(count / 1e6)} MB`);
const UNITS = { bytes: (v) => bytes(v), fraction: (v) => `${telling(v * 100)} %`, percent: (v) => `${telling(v)} %`, s: (v) => `${telling(v)} s`, ms: (v) => `${telling(v)} ms`, us: (v) => `${telling(v)} µs`, days: (v) => `${telling(v)} days` };

// Every other field of the status: its name ends with the unit.
function addFact(facts, name, value) {
  if (value === null || (Array.isArray(value) && !value.length)) return;
  if (typeof value === "object" && !Array.isArray(value)) {
    for (const [part, inner] of Object.entries(value)) addFact(facts, `${name}_${part}`, inner);
    return;
  }
  const words = name.split("_");
  const unit = typeof value === "number" ? UNITS[words.at(-1)] : undefined;
  const title = (unit ? words.slice(0, -1) : words).join(" ");
  const text = unit ? unit(value) : typeof value === "number" ? telling(value) : typeof value === "boolean" ? (value ? "yes" : "no") : Array.isArray(value) ? value.join(", ") : /^\d{4}-\d\d-\d\dT/.test(value) ? moment(value) : String(value);
  facts[title.charAt(0).toUpperCase() + title.slice(1)] = text;
}

async function refreshSky() {
  const sun = await ask("/v1/sun");
  known.sun = sun;
  if (sun.calibration !== known.calibration || sun.time.slice(0, 13) !== known.hour) {
    known.overlay = await ask("/v1/overlay");
    known.calibration = sun.calibration;
    known.hour = sun.time.slice(0, 13);
    known.uncertainty = sun.calibration ? await ask("/v1/uncertainty") : null;
    drawSigma(known.uncertainty, known.overlay, known.status?.image_size);
    refresh(refreshStatus);
    redrawResiduals();
  }
  showSun();
}

// Where the sun was expected and seen at the time of a sighting, by the current calibration.
function ofSighting(point) {
  const { residual } = point;
  return { seen: [point.x_px, point.y_px], expected: residual && [point.x_px - residual.x_px, point.y_px - residual.y_px] };
}

// The marks in the picture: of the sighting of its cycle, and where there is none the sun expected at its time.
function marks() {
  const { time, sun } = known.sunInPicture ?? { time: known.sun?.time, sun: known.sun };
  const off = (point) => Math.abs(Date.parse(point.time) - Date.parse(time));
  const near = known.points.filter((point) => point.accepted && off(point) <= SAME_MS).sort((one, other) => off(one) - off(other))[0];
  const both = near ? ofSighting(near) : { seen: null, expected: null };
  return { seen: both.seen, expected: both.expected ?? sun?.pixel ?? null };
}

const pixelText = (pixel) => `${pixel.map((value) => value.toFixed(2)).join(", ")} px`;

function sightingText(point, zone) {
  const { seen, expected } = ofSighting(point);
  const was = `${zoned(point.time, zone)}: seen at ${pixelText(seen)}`;
  if (!expected) return was;
  const { distance_px, sigma_px } = point.residual;
  return `${was}, expected at ${pixelText(expected)}; ${telling(distance_px, " px")} apart, 1-sigma ${telling(sigma_px, " px")} per axis`;
}

// A clock that matters in the error of the pixel that is expected now.
const clockText = (clock) => (clock?.max_error_s > LEAST_CLOCK_S ? `, by a clock that is right within ${telling(clock.max_error_s)} s` : "");

// Where the sun is expected and was seen last, over the picture and in words.
function showSun() {
  redrawSky();
  const { sun } = known;
  if (!sun) return;
  const last = known.points.find((point) => point.accepted);
  const zone = known.status?.timezone;
  const taken = pictureTime();
  const taking = known.status?.sky.observed === "sun" ? "Picture taken" : "Last picture by day, taken";
  write($("sky-time"), taken ? `${taking} ${zoned(taken, zone)} (${ago(taken, sun.time)})` : "");
  if (taken) $("sky-time").dataset.time = taken;
  fillFacts("sun", {
    "Sun now": `apparent zenith ${fixed(sun.apparent_zenith, 3, "°")}, azimuth ${fixed(sun.azimuth, 3, "°")} (${zoned(sun.time, zone)})`,
    "Expected now": sun.pixel ? `${pixelText(sun.pixel)} ± ${telling(sun.sigma_px, " px")}${clockText(known.status?.clock)}` : sun.apparent_zenith > 90 ? "below the horizon" : sun.calibration ? "outside the camera's field" : "no calibration yet",
    "Last sighting at": last ? sightingText(last, zone) : "not yet",
  });
}

// Where the camera stands, as its record has it; it does not change.
async function readSite() {
  const { default: name, cameras } = await ask("/v1/cameras");
  known.site = cameras.find((camera) => camera.name === name) ?? null;
  redrawFirst();
}

function redrawFirst() {
  if (known.status) drawFirst(known, known.site);
}

const zoom = new Zoom($("picture"), (part, factor) => { showPart(part, factor, known.status); redrawSky(); }, ([x, y]) => {
  [$("ask-x").value, $("ask-y").value] = [x.toFixed(1), y.toFixed(1)];
  refresh(askSky);
});

function redrawSky() {
  if (!known.sun) return;
  zoom.fit(known.status?.image_size ?? [1, 1]);
  drawSky(known.status?.image_size, zoom.part, known.overlay, marks(), known.asked, firstWay(known.status, known.points));
}

async function askSky() {
  known.asked = await lookUp();
  redrawSky();
}

const redrawResiduals = () => drawResiduals(known.points, known.overlay, known.status?.image_size, known.status?.calibration?.pose_epoch);

// The newest sightings: all at first and after another calibration, since their residuals are by it; then those that came.
async function refreshResiduals() {
  const newest = known.points[0]?.time;
  const since = newest && known.residualsBy === known.calibration ? `&since=${encodeURIComponent(newest)}` : "";
  const come = (await ask(`/v1/sun-points?residuals=true&accepted=true&limit=${MOST_POINTS}${since}`)).sun_points;
  known.points = since ? [...come.filter((point) => point.time > newest), ...known.points].slice(0, MOST_POINTS) : come;
  known.residualsBy = known.calibration;
  if (come.length > (since ? 1 : 0) || !since) {
    redrawResiduals();
    showSun();
  }
  redrawFirst();
}

async function refreshRecord() {
  const days = spanDays();
  const until = (known.status?.frame_time ?? "").slice(0, 10);
  const before = (count) => new Date(Date.parse(until) - (count - 1) * 86400000).toISOString().slice(0, 10);
  const since = until ? before(Math.min(days, COUNTED_DAYS)) : null;
  const step = days > MOST_HOURLY_DAYS ? "day" : "hour";
  const [record, calibrations, counts, housekeeping] = await Promise.all([
    ask(`/v1/days?limit=${Math.max(CALENDAR_DAYS, days)}`), ask("/v1/calibrations?limit=1000"),
    ask(`/v1/sun-points/days?${since ? `since=${since}` : ""}`),
    ask(`/v1/housekeeping?step=${step}${until ? `&since=${before(days)}T00:00:00Z` : ""}`), refresh(refreshEvents), // one at a time: a late answer replaces no newer one
  ]);
  [known.days, known.calibrations, known.counts] = [record.days, calibrations.calibrations, counts.days];
  known.housekeeping = housekeeping;
  known.nights = await readNights().catch(() => known.nights);
  drawCalendar(known.days.slice(0, CALENDAR_DAYS), known.nights.slice(0, CALENDAR_DAYS), known.status?.frame_time);
  redrawHistory();
  redrawFirst();
  offerComparison(known.calibrations);
  fillRows("calibrations", known.calibrations.slice(0, MOST_ROWS).map((c) => [
    judged(c.state), moment(c.created_at), telling(c.rmse_px, " px"), telling(c.sky_rms_deg, "°"), moment(c.valid_from), findingsOf(c),
  ]), "None yet: the first one follows the first clear day.");
}

const redrawHistory = () => drawHistory(known.calibrations, known.days, known.counts, known.housekeeping);

const refreshHorizon = () => readHorizon(known.status);

async function refreshEvents() {
  const filters = { kind: $("event-kind").value.trim(), severity: $("event-severity").value };
  const query = Object.entries(filters).filter(([, value]) => value).map(([name, value]) => `&${name}=${encodeURIComponent(value)}`).join("");
  const { events } = await ask(`/v1/events?limit=${known.events}${query}`);
  for (const event of events) known.kinds.add(event.kind);
  $("event-kinds").replaceChildren(...[...known.kinds].sort().map((kind) => { const option = node("option"); option.value = kind; return option; }));
  fillRows("events", events.map((event) => [moment(event.time), judged(event.severity), happened(event)]), query ? "No such events." : "No events yet.");
  $("events-older").hidden = events.length < known.events || known.events >= MOST_EVENTS;
}

async function refreshMoves() {
  const { events } = await ask("/v1/events?to_acknowledge=true&limit=20");
  const others = String(events.map(({ id }) => id)) !== String(known.moves.map(({ id }) => id));
  known.moves = events;
  if (others) refresh(refreshStatus);
  drawMoves(events, known.status, () => [refreshMoves, refreshStatus, refreshRecord].forEach(refresh));
}

function findingsOf(calibration) {
  const cell = document.createElement("span");
  const link = node("a", calibration.id);
  link.href = `/v1/calibrations/${encodeURIComponent(calibration.id)}`;
  cell.append(calibration.pinned ? "pinned; " : "", sentences(calibration.reasons, calibration.findings), " (", link, ")");
  return cell;
}

function complain(error) {
  if (error instanceof NeedsToken) {
    $("token-form").hidden = false;
    showHealth("locked", "a token is needed to read");
  } else showHealth("gone", "the service does not answer");
}

const refreshes = new Map();
const refreshedAt = new Map();

function happened(event) {
  const cell = document.createElement("span");
  cell.append(node("code", event.kind), " ", sentences([event.text], event.findings));
  return cell;
}

// Refresh now, or after the refresh that is under way: several messages at once cost one.
async function refresh(what) {
  if (document.hidden) return;
  if (refreshes.has(what)) { refreshes.set(what, true); return; }
  refreshes.set(what, false);
  try { await what(); refreshedAt.set(what, performance.now()); } catch (error) { if (what === refreshStatus || error instanceof NeedsToken) complain(error); }
  const again = refreshes.get(what);
  refreshes.delete(what);
  if (again) await refresh(what);
}

// What a message of the stream says is out of date.
const STALE = {
  state: [refreshStatus, refreshSky, refreshMoves, refreshRecord],
  calibration: [refreshStatus, refreshSky, refreshResiduals, refreshRecord],
  bump: [refreshStatus, refreshMoves, refreshRecord],
  day: [refreshStatus, refreshRecord],
  event: [refreshMoves, refreshRecord],
};

// The stream begins with the state: what the page has just asked for is not asked again.
const isFresh = (what) => performance.now() - (refreshedAt.get(what) ?? -Infinity) < FRESH_MS;

function outdated(kind) {
  const parts = STALE[kind] ?? [refreshStatus];
  (kind === "state" ? parts.filter((what) => !refreshes.has(what) && !isFresh(what)) : parts).forEach(refresh);
}

async function every(milliseconds, what) {
  for (;;) {
    await new Promise((done) => { setTimeout(done, milliseconds); });
    await refresh(what);
  }
}

$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  keepToken($("token").value.trim());
  $("token").value = "";
  [refreshStatus, refreshSky, refreshMoves, refreshResiduals, refreshRecord, readSite, refreshHorizon].forEach(refresh);
});
window.addEventListener("resize", () => { redrawResiduals(); redrawHistory(); refresh(refreshHorizon); });
$("history-span").addEventListener("change", () => { redrawHistory(); refresh(refreshRecord); });
$("show-mask").addEventListener("change", () => showMask());
$("zoom-in").addEventListener("click", () => zoom.by(2, known.asked ?? undefined));
$("zoom-out").addEventListener("click", () => zoom.by(0.5));
$("zoom-whole").addEventListener("click", () => zoom.whole());
$("events-older").addEventListener("click", () => { known.events = Math.min(known.events + MORE_EVENTS, MOST_EVENTS); refresh(refreshEvents); });
const compareChosen = () => compare(known.overlay);
for (const [id, act] of [["ask-form", () => refresh(askSky)], ["compare-form", () => refresh(compareChosen)], ["events-form", () => { known.events = MORE_EVENTS; refresh(refreshEvents); }]]) {
  $(id).addEventListener("submit", (event) => { event.preventDefault(); act(); });
}
document.querySelectorAll("input[name=unit]").forEach((input) => input.addEventListener("change", redrawResiduals));
await refresh(refreshStatus);
await refresh(refreshSky);
refresh(refreshMoves);
await refresh(refreshResiduals);
refresh(refreshRecord).then(() => refresh(refreshStatus)); // the headline names the last clear day
refresh(readSite);
refresh(refreshHorizon);
listen("/v1/events/stream", ({ kind }) => outdated(kind), () => refresh(refreshStatus));
every(STATUS_MS, refreshStatus);
every(SKY_MS, refreshSky);
every(RESIDUALS_MS, refreshResiduals);
every(STATUS_MS, refreshMoves);
every(RECORD_MS, refreshRecord);
every(RECORD_MS, refreshHorizon);
document.addEventListener("visibilitychange", () => [refreshStatus, refreshSky, refreshResiduals].forEach(refresh));

// The fleet page: asks the hub, draws what it says, and asks again.
import { ask, keepToken, NeedsToken } from "./ask.js";
import { $, ago, element, fixed, moment, node, telling, write } from "./draw.js";

const AGAIN_MS = 10000;
// More cameras than this are shown in small print, and on the map the names of those alone that are not ready.
const MANY = 20;
const SIGNS = { not_serving: "✕", attention: "!", starting: "…", ready_with_note: "✓", ready: "✓" };
const WORDS = { not_serving: "not serving", attention: "attention", starting: "starting", ready_with_note: "ready with a note", ready: "ready" };
// States that an operator looks at.
const NEEDS = ["not_serving", "attention"];
const [WIDTH, HEIGHT, MARGIN] = [400, 300, 30];

// What neighbours show and nobody has to correct; the other words are alarms.
const NO_ALARMS = ["slow_turn", "unconfirmed"];
const alarmed = (check) => check.found.some((word) => !NO_ALARMS.includes(word));

function row(...cells) {
  const line = node("tr");
  line.append(...cells.map((cell) => (cell instanceof Node ? cell : node("td", cell))));
  return line;
}

// A value that is zero within its error is shown all the same: an absence is an answer.
const measured = (value, sigma, unit) => (value === null ? "–" : `${telling(value)} ± ${Number(sigma.toPrecision(2))}${unit}`);
const agreed = (check) => (check.since ? `${check.agreeing} of ${check.neighbours.length}, ${fixed(check.confidence, 2)}` : "–");
const words = (check) => check.found.join(", ").replaceAll("_", " ");

function mark(check) {
  if (!check) return node("td", "–");
  return node("td", check.found.length ? `${alarmed(check) ? "!" : "·"} ${words(check)}` : "✓ nothing", alarmed(check) ? "alarmed" : "");
}

function ofCheck(c) {
  const name = node("th", c.camera);
  name.scope = "row";
  return row(
    name, mark(c), c.since ?? "–", agreed(c), measured(c.clock_s, c.clock_sigma_s, " s"), measured(c.longitude_deg, c.longitude_sigma_deg, "°"),
    measured(c.north_deg, c.north_sigma_deg, "°"), measured(c.cloud_clock_s, c.cloud_clock_sigma_s, " s"), c.neighbours.join(", "),
  );
}

function ofCamera(c, now, check) {
  const status = c.status ?? {};
  const name = node("th", c.camera);
  name.scope = "row";
  const said = c.service_state === "ready" ? [] : [c.state_text];
  const why = node("td", [...new Set([...said, ...c.why.map((one) => one.text)])].join("; ") || "–", "why");
  why.title = why.textContent; // the row may be too short for it
  return row(
    name, `${SIGNS[c.service_state]} ${WORDS[c.service_state]}`, why, c.received_at ? ago(c.received_at, now) : "never", moment(c.last_sighting_at),
    telling(c.sky_rms_deg, "°"), telling(status.drift_deg, "°"), status.disk_free_bytes == null ? "–" : fixed(status.disk_free_bytes / 1e9, 1, " GB"),
    telling(status.clock_error_s, " s"), mark(check), String(c.n_quarantined),
  );
}

// Cameras by longitude and latitude, one scale for both at their mean latitude.
function drawMap(cameras) {
  const placed = cameras.filter((c) => c.latitude !== null && c.longitude !== null);
  const east = (c) => c.longitude * Math.cos((placed[0].latitude * Math.PI) / 180);
  const xs = placed.map(east), ys = placed.map((c) => c.latitude);
  const span = Math.max(Math.max(...xs) - Math.min(...xs), (Math.max(...ys) - Math.min(...ys)) * (WIDTH / HEIGHT), 1e-3);
  const scale = (WIDTH - 2 * MARGIN) / span;
  const at = placed.map((_, i) => [MARGIN + (xs[i] - Math.min(...xs)) * scale, HEIGHT - MARGIN - (ys[i] - Math.min(...ys)) * scale]);
  const dots = placed.map((c, i) => element("circle", { class: c.service_state, cx: at[i][0], cy: at[i][1], r: 5 }));
  const names = placed.flatMap((c, i) => (placed.length <= MANY || NEEDS.includes(c.service_state)
    ? [element("text", { x: at[i][0], y: at[i][1] - 8 }, `${SIGNS[c.service_state]} ${c.camera}`)] : []));
  $("map").replaceChildren(...dots, ...names);
}

// Hubs that share the database; those of two versions are not to.
function beside(hubs) {
  const shown = hubs.map((hub) => `${hub.address} (${hub.version}) since ${moment(hub.started_at)}`).join(", ");
  const differ = new Set(hubs.map((hub) => hub.version)).size > 1 ? " ! of different versions" : "";
  return hubs.length ? ` · ${hubs.length === 1 ? "hub" : `${hubs.length} hubs`}${differ}: ${shown}` : "";
}

function showAll(fleet, quarantine, crossed) {
  const checks = new Map(crossed.checks.map((check) => [check.camera, check]));
  const cameras = fleet.cameras;
  const bad = cameras.filter((c) => NEEDS.includes(c.service_state)).length;
  const starting = cameras.filter((c) => c.service_state === "starting").length;
  $("health").dataset.health = bad ? "degraded" : "ready";
  write($("verdict"), bad ? `! ${bad} of ${fleet.cameras.length} need a look` : `✓ ${fleet.cameras.length} cameras${starting ? `, ${starting} starting` : ""}`);
  write($("headline"), `at ${moment(fleet.time)} UTC${beside(fleet.hubs)}`);
  $("cameras").replaceChildren(...cameras.map((c) => ofCamera(c, fleet.time, checks.get(c.camera))));
  document.body.classList.toggle("many", cameras.length > MANY);
  $("checks").replaceChildren(...crossed.checks.filter((check) => check.found.length).map(ofCheck));
  write($("checks-about"), crossed.night
    ? `night of ${crossed.night}: ${crossed.checks.length} cameras compared with neighbours, ${crossed.checks.filter(alarmed).length} with an alarm` : "none yet");
  $("quarantine").replaceChildren(...quarantine.rows.map((q) => row(q.camera, q.reason, q.text, String(q.n), moment(q.last_at))));
  ["cameras", "checks", "quarantine"].forEach(nameCells);
  drawMap(cameras);
}

// On a phone a row is a list of its cells, each with the heading of its column.
function nameCells(table) {
  const titles = [...$(table).parentElement.querySelectorAll("thead th")].map((title) => title.textContent);
  for (const line of $(table).rows) [...line.cells].forEach((cell, i) => { if (cell.tagName === "TD") cell.dataset.title = titles[i]; });
}

async function refresh() {
  try {
    showAll(await ask("/v1/fleet"), await ask("/v1/quarantine?limit=50"), await ask("/v1/cross-checks"));
    $("token-form").hidden = true;
  } catch (error) {
    $("token-form").hidden = !(error instanceof NeedsToken);
    $("health").dataset.health = error instanceof NeedsToken ? "locked" : "gone";
    write($("verdict"), error instanceof NeedsToken ? "! Locked" : "✕ No answer");
  }
}

$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  keepToken($("token").value);
  refresh();
});
refresh();
setInterval(refresh, AGAIN_MS);

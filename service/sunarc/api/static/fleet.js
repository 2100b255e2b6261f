// The fleet page: asks the hub, draws what it says, and asks again.
import { ask, keepToken, NeedsToken } from "./ask.js";
import { $, ago, element, fixed, moment, node, telling } from "./draw.js";

const AGAIN_MS = 10000;
const SIGNS = { silent: "✕", not_ready: "✕", degraded: "!", quarantine: "!", uncalibrated: "…", ready: "✓" };
const [WIDTH, HEIGHT, MARGIN] = [400, 300, 30];

function row(...cells) {
  const line = node("tr");
  line.append(...cells.map((cell) => (cell instanceof Node ? cell : node("td", cell))));
  return line;
}

function ofCamera(c, now) {
  const status = c.status ?? {};
  const name = node("th", c.camera);
  name.scope = "row";
  return row(
    name, `${SIGNS[c.state]} ${c.state.replace("_", " ")}`, c.received_at ? ago(c.received_at, now) : "never", moment(c.last_sighting_at),
    telling(c.sky_rms_deg, "°"), telling(status.drift_deg, "°"), status.disk_free_bytes == null ? "–" : fixed(status.disk_free_bytes / 1e9, 1, " GB"),
    telling(status.clock_error_s, " s"), String(c.n_quarantined),
  );
}

// Cameras by longitude and latitude, one scale for both at their mean latitude.
function drawMap(cameras) {
  const placed = cameras.filter((c) => c.latitude !== null && c.longitude !== null);
  const east = (c) => c.longitude * Math.cos((placed[0].latitude * Math.PI) / 180);
  const xs = placed.map(east), ys = placed.map((c) => c.latitude);
  const span = Math.max(Math.max(...xs) - Math.min(...xs), (Math.max(...ys) - Math.min(...ys)) * (WIDTH / HEIGHT), 1e-3);
  const scale = (WIDTH - 2 * MARGIN) / span;
  $("map").replaceChildren(...placed.flatMap((c, i) => {
    const x = MARGIN + (xs[i] - Math.min(...xs)) * scale, y = HEIGHT - MARGIN - (ys[i] - Math.min(...ys)) * scale;
    return [element("circle", { class: c.state, cx: x, cy: y, r: 5 }), element("text", { x: x + 7, y: y + 4 }, `${SIGNS[c.state]} ${c.camera}`)];
  }));
}

function showAll(fleet, quarantine) {
  const bad = fleet.cameras.filter((c) => !["ready", "uncalibrated"].includes(c.state)).length;
  $("health").dataset.health = bad ? "degraded" : "ready";
  $("verdict").textContent = bad ? `! ${bad} of ${fleet.cameras.length} need a look` : `✓ ${fleet.cameras.length} cameras`;
  $("headline").textContent = `at ${moment(fleet.time)} UTC`;
  $("cameras").replaceChildren(...fleet.cameras.map((c) => ofCamera(c, fleet.time)));
  $("quarantine").replaceChildren(...quarantine.rows.map((q) => row(q.camera, q.reason, q.text, String(q.n), moment(q.last_at))));
  drawMap(fleet.cameras);
}

async function refresh() {
  try {
    showAll(await ask("/v1/fleet"), await ask("/v1/quarantine?limit=50"));
    $("token-form").hidden = true;
  } catch (error) {
    $("token-form").hidden = !(error instanceof NeedsToken);
    $("health").dataset.health = error instanceof NeedsToken ? "locked" : "gone";
    $("verdict").textContent = error instanceof NeedsToken ? "! Locked" : "✕ No answer";
  }
}

$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  keepToken($("token").value);
  refresh();
});
refresh();
setInterval(refresh, AGAIN_MS);

// The dashboard: asks the API, draws what it says, and asks again. Text only ever goes in as text.
const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const SIGNS = { ready: ["✓", "Ready"], degraded: ["!", "Degraded"], not_ready: ["✕", "Not ready"], gone: ["✕", "No answer"] };
const GOOD = ["running", "current", "clear", "info", "accepted"];
const BAD = ["failed", "stopped", "refused", "unusable", "alarm"];
const known = { status: null, points: [], calibration: null };

async function ask(path, body) {
  const how = body ? { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) } : {};
  const answer = await fetch(path, { ...how, signal: AbortSignal.timeout(8000) });
  if (answer.status === 404) return null;
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}

function element(name, attributes = {}, text = null) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  return made;
}

function node(name, text, className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

const fixed = (value, digits, unit = "") => (value === null || value === undefined ? "–" : `${value.toFixed(digits)}${unit}`);
const moment = (time) => (time ? time.replace("T", " ").replace(/(\.\d+)?Z$/, "") : "–");

function ago(time, now) {
  if (!time) return "never";
  const seconds = Math.max(0, (Date.parse(now) - Date.parse(time)) / 1000);
  if (seconds < 120) return `${seconds.toFixed(0)} s ago`;
  if (seconds < 7200) return `${(seconds / 60).toFixed(0)} min ago`;
  return seconds < 172800 ? `${(seconds / 3600).toFixed(0)} h ago` : `${(seconds / 86400).toFixed(0)} days ago`;
}

function judged(word) {
  const kind = GOOD.includes(word) ? "good" : BAD.includes(word) ? "bad" : word === "retired" ? "none" : "warn";
  return node("span", `${{ good: "✓", bad: "✕", warn: "!", none: "·" }[kind]} ${word}`, kind);
}

function fillRows(id, rows, empty) {
  const body = $(id).tBodies[0];
  const columns = $(id).tHead.rows[0].cells.length;
  body.replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    for (const cell of cells) {
      const td = document.createElement("td");
      td.append(cell);
      row.append(td);
    }
    return row;
  }));
  if (rows.length) return;
  const td = node("td", empty, "none");
  td.colSpan = columns;
  body.append(document.createElement("tr"));
  body.firstChild.append(td);
}

function fillFacts(id, facts) {
  $(id).replaceChildren(...Object.entries(facts).flatMap(([name, value]) => [node("dt", name), node("dd", value)]));
}

function showHealth(health, headline) {
  const [sign, word] = SIGNS[health];
  $("health").dataset.health = health;
  $("health-sign").textContent = sign;
  if ($("health-word").textContent !== word) $("health-word").textContent = word;
  $("headline").textContent = headline;
  document.title = `${sign} ${word} · ${known.status?.camera_name ?? ""} · sunarc`;
}

async function refreshStatus() {
  const status = await ask("/v1/status");
  known.status = status;
  $("camera-name").textContent = `· ${status.camera_name}`;
  $("version").textContent = `sunarc ${status.version}`;
  const c = status.calibration;
  const sure = c ? `calibrated to ${fixed(c.rmse_px, 3, " px")} RMSE, the sky known to ${fixed(c.sky_rms_deg, 4, "°")}` : "not calibrated yet";
  showHealth(status.health, `${sure} · ${status.last_sighting_at ? `sun last seen ${ago(status.last_sighting_at, status.frame_time)}` : "sun not seen yet"}`);
  $("reasons").replaceChildren(...status.reasons.map((reason) => {
    const item = node("li", "");
    item.dataset.severity = reason.severity;
    item.append(node("b", `${reason.severity === "not_ready" ? "✕" : "!"} ${reason.text}.`), node("span", `Remedy: ${reason.remedy}.`));
    return item;
  }));
  fillRows("workers", status.workers.map((w) => [
    w.name, judged(w.state), fixed(w.heartbeat_age_s, 0, " s ago"), w.last_error ? `${w.restarts} (${w.last_error})` : String(w.restarts),
  ]), "No worker has started.");
  fillFacts("facts", factsOf(status));
  showImage(status);
}

function factsOf(status) {
  const { camera, clock } = status;
  return {
    Camera: camera ? `${camera.connected ? "✓ connected" : "✕ not connected"} ${[camera.model, camera.serial, camera.address].filter(Boolean).join(", ")}` : "not known yet",
    "Last frame": `${moment(status.last_frame_at)} (${ago(status.last_frame_at, status.frame_time)})`,
    "Last sighting": `${moment(status.last_sighting_at)} (${ago(status.last_sighting_at, status.frame_time)})`,
    Clock: clock && clock.synchronised !== null ? `${clock.synchronised ? "✓ synchronised" : "! not synchronised"}${clock.max_error_s === null ? "" : `, within ${clock.max_error_s.toPrecision(2)} s`}` : "not known yet",
    "Disk free": status.disk_free_bytes === null ? "not known yet" : `${(status.disk_free_bytes / 1e9).toFixed(1)} GB`,
    "Running since": moment(status.started_at),
  };
}

function showImage(status) {
  const stamp = status.last_frame_at ?? "";
  const image = $("image");
  if (!stamp || image.dataset.stamp === stamp) return;
  image.dataset.stamp = stamp;
  const next = new Image();
  next.onload = () => { image.src = next.src; image.hidden = false; $("no-image").hidden = true; };
  next.src = `/v1/image/latest?frame=${encodeURIComponent(stamp)}`;
}

const path = (pixels) => {
  let pen = "M";
  return pixels.map((p) => { const step = p ? `${pen}${p[0]} ${p[1]}` : ""; pen = p ? "L" : "M"; return step; }).join("");
};

async function refreshSky() {
  const [sun, track] = await Promise.all([ask("/v1/sun"), ask("/v1/sun/track?step_s=120")]);
  if (sun.calibration !== known.calibration) {
    known.calibration = sun.calibration;
    known.rings = sun.calibration ? await ringsOf([30, 60, 90]) : [];
    drawResiduals();
  }
  $("sky-time").textContent = moment(sun.time);
  const last = known.points.find((point) => point.accepted);
  drawSky(sun, track, last);
  fillFacts("sun", {
    Sun: `apparent zenith ${fixed(sun.apparent_zenith, 3, "°")}, azimuth ${fixed(sun.azimuth, 3, "°")}`,
    "Expected at": sun.pixel ? `${sun.pixel.map((v) => v.toFixed(2)).join(", ")} px ± ${fixed(sun.sigma_px, 4)}` : sun.calibration ? "outside the camera's field" : "no calibration yet",
    "Last seen at": last ? `${fixed(last.x_px, 2)}, ${fixed(last.y_px, 2)} px ± ${fixed(last.sigma_px, 2)} (${moment(last.time)})` : "not yet",
  });
}

async function ringsOf(zeniths) {
  const azimuths = [...Array(73).keys()].map((k) => k * 5);
  const asked = { zenith_deg: zeniths.flatMap((zenith) => azimuths.map(() => zenith)), azimuth_deg: zeniths.flatMap(() => azimuths) };
  const pixels = (await ask("/v1/project", asked))?.pixels ?? [];
  return zeniths.map((_, k) => pixels.slice(k * 73, (k + 1) * 73));
}

function compass(width, height) {
  const horizon = known.rings?.at(-1) ?? [];
  return ["N", "E", "S", "W"].map((name, k) => [name, horizon[k * 18]]).filter(([, at]) => at)
    .map(([name, [x, y]]) => [name, [width / 2 + (x - width / 2) * 0.94, height / 2 + (y - height / 2) * 0.94]]);
}

function drawSky(sun, track, last) {
  const [width, height] = known.status?.image_size ?? [1, 1];
  const u = width / 100;
  const overlay = $("overlay");
  overlay.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
  document.querySelector(".picture").style.aspectRatio = `${width} / ${height}`;
  const parts = [element("path", { class: "horizon", d: path(known.rings?.at(-1) ?? []) })];
  compass(width, height).forEach(([name, at]) => parts.push(label(at, name, u * 4, "corner")));
  parts.push(element("path", { class: "track", d: path(track.pixels) }));
  track.time.forEach((time, k) => {
    const at = track.pixels[k];
    if (!at || !/T\d\d:00:00/.test(time)) return;
    parts.push(element("circle", { class: "hour", cx: at[0], cy: at[1], r: u * 0.7 }));
    if (Number(time.slice(11, 13)) % 2 === 0) parts.push(label([at[0], at[1] - u * 1.6], `${time.slice(11, 13)}h`, u * 2.8, "hour-name"));
  });
  if (last) parts.push(mark("M0-1.5L1.5 0L0 1.5L-1.5 0Z", "seen", [last.x_px, last.y_px], u));
  if (sun.pixel) for (const style of ["expected-under", "expected"]) {
    parts.push(mark("M0-4.4V-2M0 4.4V2M-4.4 0H-2M4.4 0H2M2.7 0A2.7 2.7 0 1 1-2.7 0A2.7 2.7 0 1 1 2.7 0", style, sun.pixel, u));
  }
  overlay.replaceChildren(...parts);
}

const mark = (d, style, at, scale) => element("path", { class: style, d, transform: `translate(${at[0]} ${at[1]}) scale(${scale})` });
const label = (at, text, size, style) => element("text", { class: style, x: at[0], y: at[1], "font-size": size, "text-anchor": "middle", "dominant-baseline": "middle" }, text);

async function refreshResiduals() {
  const told = await ask("/v1/sun-points?residuals=true&limit=1000");
  known.points = told.sun_points;
  drawResiduals();
}

function drawResiduals() {
  const unit = document.querySelector("input[name=unit]:checked").value;
  const points = known.points.filter((point) => point.residual);
  const rejected = known.points.filter((point) => !point.accepted).length;
  const rms = (pick) => Math.sqrt(points.reduce((sum, point) => sum + pick(point.residual) ** 2, 0) / points.length);
  $("residual-sum").textContent = points.length
    ? `RMSE of the last ${points.length} sightings: ${rms((r) => r.distance_px).toFixed(3)} px, ${rms((r) => r.distance_deg ?? 0).toFixed(4)}°. ${rejected} looks gave no sighting.`
    : "No sighting with a calibration to compare it with yet.";
  const series = unit === "px"
    ? [["x-mark", "x, px", (r) => r.x_px], ["y-mark", "y, px", (r) => r.y_px]]
    : [["x-mark", "distance, degrees", (r) => r.distance_deg]];
  $("plots").hidden = !points.length;
  if (!points.length) return;
  drawByTime(points, series);
  drawBySky(points);
  $("by-time-legend").className = "legend plain";
  $("by-time-legend").replaceChildren(...series.map(([style, name]) => {
    const item = node("li", ` ${name}`);
    const key = element("svg", { viewBox: "-10 -10 20 20" });
    key.append(symbol(style, 0, 0, 4));
    item.prepend(key);
    return item;
  }));
}

const symbol = (style, x, y, r) => (style === "x-mark"
  ? element("circle", { class: style, cx: x, cy: y, r })
  : element("rect", { class: style, x: x - r, y: y - r, width: 2 * r, height: 2 * r }));

function ticksOf(low, high, count) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((k) => k * power >= raw) * power;
  const ticks = [];
  for (let k = Math.ceil(low / step); k * step <= high; k += 1) ticks.push(k * step);
  return { ticks, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

const STEPS = [60, 300, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 432000, 864000].map((s) => s * 1000);

function timeTicks(from, to, most) {
  const step = STEPS.find((one) => (to - from) / one <= most) ?? STEPS[STEPS.length - 1];
  const ticks = [];
  for (let at = Math.ceil(from / step) * step; at <= to; at += step) ticks.push(at);
  return ticks.map((at) => [at, step >= 86400000 ? new Date(at).toISOString().slice(5, 10) : new Date(at).toISOString().slice(11, 16)]);
}

function drawByTime(points, series) {
  const plot = $("by-time");
  const [width, height, left, bottom] = [plot.clientWidth || 600, 240, 56, 24];
  plot.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const times = points.map((point) => Date.parse(point.time));
  const [from, to] = [Math.min(...times), Math.max(...times, Math.min(...times) + 1)];
  const values = series.flatMap(([, , pick]) => points.map((point) => pick(point.residual) ?? 0)).map(Math.abs).sort((a, b) => a - b);
  const reach = Math.max(values[Math.floor(values.length * 0.995)] ?? 0, 1e-6) * 1.15;
  const low = series.length === 1 ? 0 : -reach;
  const x = (time) => left + ((time - from) / (to - from)) * (width - left - 12);
  const y = (value) => 8 + (1 - (Math.max(low, Math.min(reach, value)) - low) / (reach - low)) * (height - 16 - bottom);
  const { ticks, digits } = ticksOf(low, reach, 5);
  const parts = ticks.flatMap((tick) => [
    element("path", { class: Math.abs(tick) < 1e-12 ? "zero" : "grid", d: `M${left} ${y(tick)}H${width - 8}` }),
    element("text", { x: left - 6, y: y(tick) + 4, "text-anchor": "end" }, tick.toFixed(digits)),
  ]);
  for (const [at, text] of timeTicks(from, to, width / 70)) {
    parts.push(element("text", { x: x(at), y: height - 6, "text-anchor": "middle" }, text));
  }
  for (const [style, , pick] of series) {
    points.forEach((point, k) => { if (pick(point.residual) !== null) parts.push(symbol(style, x(times[k]), y(pick(point.residual)), 2)); });
  }
  plot.replaceChildren(...parts);
}

function drawBySky(points) {
  const plot = $("by-sky");
  const [width, height] = known.status?.image_size ?? [1, 1];
  const [across, down] = [400, (400 * height) / width];
  const s = across / width;
  plot.setAttribute("viewBox", `0 0 ${across} ${down}`);
  const onto = (at) => at && [(at[0] + 0.5) * s, (at[1] + 0.5) * s];
  const parts = (known.rings ?? []).map((ring) => element("path", { class: "grid", d: path(ring.map(onto)) }));
  compass(width, height).forEach(([name, at]) => parts.push(label(onto(at), name, 13, "")));
  const lengths = points.map((point) => point.residual.distance_px).sort((a, b) => a - b);
  const typical = lengths[Math.floor(lengths.length * 0.9)] || 1;
  const unit = ticksOf(0, typical, 2).ticks.at(-1) || typical;
  const stride = Math.max(1, Math.ceil(points.length / 200));
  for (let k = 0; k < points.length; k += stride) {
    const { residual, x_px, y_px } = points[k];
    const [x, y] = onto([x_px, y_px]);
    const scale = Math.min(24 / typical, 60 / residual.distance_px);
    parts.push(element("circle", { class: "tail", cx: x, cy: y, r: 1.6 }), element("path", { class: "arrow", d: `M${x} ${y}l${residual.x_px * scale} ${residual.y_px * scale}` }));
  }
  parts.push(element("path", { class: "arrow", d: `M12 ${down - 12}h${(unit * 24) / typical}` }), element("text", { x: 12, y: down - 20 }, `${Number(unit.toPrecision(3))} px`));
  plot.replaceChildren(...parts);
}

async function refreshRecord() {
  const [days, calibrations, events] = await Promise.all([ask("/v1/days?limit=60"), ask("/v1/calibrations?limit=50"), ask("/v1/events?limit=50")]);
  fillRows("days", days.days.map((day) => [
    day.date, judged(day.verdict), `${day.n} of ${day.n_possible}`, fixed(day.sd_px, 3, " px"), day.reasons.join("; "),
  ]), "No day has ended yet.");
  fillRows("calibrations", calibrations.calibrations.map((c) => [
    judged(c.state), moment(c.created_at), fixed(c.rmse_px, 3, " px"), fixed(c.sky_rms_deg, 4, "°"), moment(c.valid_from), because(c),
  ]), "None yet: the first one follows the first clear day.");
  fillRows("events", events.events.map((event) => [moment(event.time), judged(event.severity), event.text]), "Nothing has happened yet.");
}

function because(calibration) {
  const cell = document.createElement("span");
  const link = node("a", calibration.id);
  link.href = `/v1/calibrations/${encodeURIComponent(calibration.id)}`;
  cell.append(`${calibration.reasons.join("; ")} (`, link, ")");
  return cell;
}

async function every(milliseconds, refresh) {
  for (;;) {
    if (!document.hidden) {
      try { await refresh(); } catch (error) { if (refresh === refreshStatus) showHealth("gone", "the service does not answer"); }
    }
    await new Promise((done) => { setTimeout(done, milliseconds); });
  }
}

window.addEventListener("resize", drawResiduals);
document.querySelectorAll("input[name=unit]").forEach((input) => input.addEventListener("change", drawResiduals));
await refreshStatus().catch(() => showHealth("gone", "the service does not answer"));
await refreshResiduals().catch(() => {});
every(2000, refreshStatus);
every(2500, refreshSky);
every(5000, refreshResiduals);
every(5000, refreshRecord);

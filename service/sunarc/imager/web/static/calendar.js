// The days as a calendar of verdicts: weeks as rows, a sign in every day, its reasons on demand.
import { $, node, sentences, telling } from "./draw.js";
import { NIGHT_SIGNS, showNight } from "./night.js";

const SIGNS = { clear: "☀", partly: "◐", cloudy: "☁", unusable: "✕" };
const WEEK = ["Mo", "Tu", "We", "Th", "Fr", "Sa", "Su"];
const DAY_MS = 86400000;
const MOST_WEEKS = 26;
const known = { days: new Map(), nights: new Map(), drawn: "", selected: null };

export function drawCalendar(days, nights, today) {
  known.days = new Map(days.map((day) => [day.date, day]));
  known.nights = new Map(nights.map((night) => [night.night, night.verdict]));
  const now = today?.slice(0, 10);
  const drawn = JSON.stringify([now, days.map((day) => [day.date, day.verdict, day.n, day.n_cycles, day.n_possible]), [...known.nights]]);
  if (drawn === known.drawn || !now) return;
  known.drawn = drawn;
  $("days-legend").replaceChildren(...Object.entries(SIGNS).map(([verdict, sign]) => explained(sign, verdict, `cell ${verdict}`)));
  $("nights-legend").replaceChildren(...(nights.length ? Object.entries(NIGHT_SIGNS).map(([verdict, sign]) => explained(sign, `${verdict} night`, `cell night ${verdict}`)) : []));
  $("calendar").replaceChildren(table(now));
  show(known.selected ?? days[0]?.date);
}

function explained(sign, text, style) {
  const item = node("li", ` ${text}`);
  const key = node("span", sign, style);
  key.setAttribute("aria-hidden", "true");
  item.prepend(key);
  return item;
}

function table(now) {
  const dates = [...known.days.keys(), ...known.nights.keys(), now].sort();
  const first = dates[0];
  const monday = (at) => at - ((new Date(at).getUTCDay() + 6) % 7) * DAY_MS;
  const last = monday(Date.parse(dates.at(-1)));
  const start = Math.max(monday(Date.parse(first)), last - (MOST_WEEKS - 1) * 7 * DAY_MS);
  const made = document.createElement("table");
  made.className = "calendar";
  const head = made.createTHead().insertRow();
  for (const name of ["Week of", ...WEEK]) {
    const th = node("th", name);
    th.scope = "col";
    head.append(th);
  }
  const body = made.createTBody();
  for (let week = last; week >= start; week -= 7 * DAY_MS) {
    const row = body.insertRow();
    const th = node("th", new Date(week).toISOString().slice(0, 10));
    th.scope = "row";
    row.append(th, ...WEEK.map((_, k) => cell(new Date(week + k * DAY_MS).toISOString().slice(0, 10), now)));
  }
  return made;
}

function cell(date, now) {
  const td = document.createElement("td");
  const day = known.days.get(date);
  if (!day) {
    td.append(node("span", String(Number(date.slice(8))), date === now ? "cell now" : "cell empty"));
    addNight(td, date);
    return td;
  }
  const button = node("button", SIGNS[day.verdict], `cell ${day.verdict}`);
  button.type = "button";
  button.dataset.date = date;
  button.setAttribute("aria-label", `${date}: ${day.verdict}`);
  button.addEventListener("click", () => show(date));
  td.append(button);
  addNight(td, date);
  return td;
}

// The night that began on a date, below its day.
function addNight(td, date) {
  const verdict = known.nights.get(date);
  if (!verdict) return;
  const button = node("button", NIGHT_SIGNS[verdict], `cell night ${verdict}`);
  button.type = "button";
  button.setAttribute("aria-label", `night of ${date}: ${verdict}`);
  button.addEventListener("click", () => { showNight(date).catch(() => {}); $("night").scrollIntoView({ block: "nearest" }); });
  td.append(button);
}

// A bracket makes several sightings in one cycle: only cycles can be counted against cycles.
function observed(day) {
  return day.n_cycles === null ? `${day.n} sightings` : `sun seen in ${day.n_cycles} of ${day.n_possible} cycles`;
}

function show(date) {
  known.selected = date ?? null;
  const day = known.days.get(date);
  for (const button of $("calendar").querySelectorAll("button[data-date]")) button.setAttribute("aria-pressed", String(button.dataset.date === date));
  if (!day) {
    $("day").textContent = "No day has ended yet.";
    return;
  }
  const scatter = day.sd_px === null ? "" : `, scatter ${telling(day.sd_px)} px`;
  $("day").replaceChildren(`${day.date}: ${day.verdict}; ${observed(day)}${scatter}. `, sentences(day.reasons, day.findings), ".");
}

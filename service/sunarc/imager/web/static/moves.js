// Moves and changes of the camera that wait for an operator: on top, with the pictures before and after.
import { acknowledge, askImage } from "./ask.js";
import { $, node, write, zoned } from "./draw.js";

const SIDES = ["before", "after"];
const TOKEN = "Token: the line in the file that api.token_file names (token in the state folder).";

export function drawMoves(events, status, done) {
  const zone = status?.timezone;
  $("moves").hidden = !events.length;
  const shown = new Map([...$("moves").children].map((one) => [one.dataset.event, one]));
  const entries = events.map((event) => shown.get(String(event.id)) ?? entry(event, zone, done));
  $("moves").replaceChildren(...entries);
  for (const one of entries) write(one.querySelector(".action"), remedyOf(one.dataset.event, status));
  for (const one of entries) one.querySelectorAll("figure[hidden]").forEach((figure) => askPicture(figure, one.dataset.event, zone));
}

function entry(event, zone, done) {
  const one = node("article");
  one.dataset.event = event.id;
  const title = node("h2", `! ${event.text}`);
  one.append(title, node("p", zoned(event.time, zone), "sum"), node("p", "", "action"), form(event, done), pictures());
  return one;
}

// What to do about a change, as the condition has it that names the event.
function remedyOf(event, status) {
  const all = [...(status?.reasons ?? []), ...(status?.notes ?? [])];
  const found = all.find((one) => concerns(one, event));
  return found ? `What to do: ${found.remedy}.` : "";
}

// Whether a condition is of an event: its remedy names it.
export const concerns = ({ remedy }, event) => new RegExp(`\\bevent ${event}\\b`).test(remedy);

function pictures() {
  const both = node("div", "", "halves");
  for (const side of SIDES) {
    const figure = node("figure");
    figure.dataset.side = side;
    figure.hidden = true;
    both.append(figure);
  }
  return both;
}

// The picture after a change comes later than the event: a figure without one is asked for again.
async function askPicture(figure, event, zone) {
  if (figure.dataset.asked) return;
  figure.dataset.asked = "true";
  const { side } = figure.dataset;
  const found = await askImage(`/v1/events/${event}/pictures/${side}?horizon=true&width=640`).catch(() => null);
  if (!found) { delete figure.dataset.asked; return; }
  const image = node("img");
  image.src = found.address;
  image.alt = `Picture ${side} the change, with the horizon by the calibration of then`;
  figure.append(image, node("figcaption", `${side[0].toUpperCase()}${side.slice(1)}: ${zoned(found.time, zone)}`));
  figure.hidden = false;
}

function form(event, done) {
  const made = node("form", "", "fields");
  const [token, reason] = [field(made, "Token", "password"), field(made, "Reason", "text")];
  token.title = TOKEN;
  token.required = true;
  token.autocomplete = "off";
  reason.placeholder = "seen";
  reason.maxLength = 500;
  const said = node("span", "", "bad");
  said.setAttribute("role", "status");
  made.append(node("button", "Acknowledge"), said, node("small", TOKEN));
  made.addEventListener("submit", async (submitted) => {
    submitted.preventDefault();
    const problem = await acknowledge(event.id, token.value.trim(), reason.value.trim()).catch(() => "the service does not answer");
    write(said, problem ?? "");
    if (!problem) done();
  });
  return made;
}

function field(made, name, type) {
  const [label, input] = [node("label", `${name} `), node("input")];
  input.type = type;
  label.append(input);
  made.append(label);
  return input;
}

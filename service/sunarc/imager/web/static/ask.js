// Questions to the API, with the token where reading needs one; it is kept in this tab alone.
const KEPT = "sunarc-token";
const SLOW_MS = 10000;
const SILENT_MS = 60000; // the service gives a sign every 15 s
const RETRY_MS = 3000;
const LONGEST_RETRY_MS = 60000;

export class NeedsToken extends Error {}

export const keepToken = (token) => sessionStorage.setItem(KEPT, token);

async function fetched(path, how = {}) {
  const token = sessionStorage.getItem(KEPT);
  const headers = { ...how.headers, ...(token ? { authorization: `Bearer ${token}` } : {}) };
  const answer = await fetch(path, { signal: AbortSignal.timeout(SLOW_MS), ...how, headers });
  if (answer.status === 401) throw new NeedsToken(path);
  if (answer.status === 404) return null;
  if (answer.status === 503 && (await answer.clone().text()).includes(":no_calibration")) return null;
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer;
}

// What a path answers, to a body where it takes one; null where there is nothing yet.
export const ask = async (path, body = null) => {
  const how = body ? { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) } : {};
  return (await fetched(path, how))?.json() ?? null;
};

// Acknowledge an event with the token of an operator; the problem in words, null where there is none.
export async function acknowledge(event, token, reason) {
  const headers = { "content-type": "application/json", authorization: `Bearer ${token}` };
  const answer = await fetch(`/v1/events/${event}/acknowledge`, { method: "POST", signal: AbortSignal.timeout(SLOW_MS), headers, body: JSON.stringify(reason ? { reason } : {}) });
  if (answer.ok) return null;
  const problem = await answer.json().catch(() => ({}));
  return problem.detail ?? problem.title ?? `it was refused (${answer.status})`;
}

// An image as an address that an element can show, and its time; whoever asked gives it back with URL.revokeObjectURL.
export async function askImage(path) {
  const answer = await fetched(path);
  return answer ? { address: URL.createObjectURL(await answer.blob()), time: answer.headers.get("sunarc-time") } : null;
}

// What the service tells as it happens, for as long as the page is shown; it is asked again when the connection ends, from
// the last message on, and `ended` is called each time it ends. EventSource would do the same, but cannot send a token.
export async function listen(path, heard, ended) {
  let last = null;
  for (let wait = RETRY_MS; ; wait = Math.min(2 * wait, LONGEST_RETRY_MS)) {
    await shown();
    try {
      for await (const message of messages(path, last)) {
        last = message.id;
        wait = RETRY_MS;
        heard(message);
      }
    } catch { /* the service does not answer: what asks for its status says so */ }
    ended();
    await new Promise((done) => { setTimeout(done, wait); });
  }
}

const shown = () => new Promise((done) => {
  if (!document.hidden) done();
  else document.addEventListener("visibilitychange", () => done(), { once: true });
});

async function* messages(path, last) {
  const ending = new AbortController();
  let timer = null;
  const alive = () => { clearTimeout(timer); timer = setTimeout(() => ending.abort(), SILENT_MS); };
  const hide = () => { if (document.hidden) ending.abort(); };
  document.addEventListener("visibilitychange", hide);
  try {
    alive();
    const answer = await fetched(path, { headers: last ? { "last-event-id": last } : {}, signal: ending.signal });
    let text = "";
    for (const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader(); ;) {
      const { value, done } = await reader.read();
      if (done) return;
      alive();
      const parts = (text + value).split("\n\n");
      text = parts.pop();
      for (const part of parts) if (/^data: /m.test(part)) yield messageOf(part);
    }
  } finally {
    clearTimeout(timer);
    document.removeEventListener("visibilitychange", hide);
    ending.abort();
  }
}

function messageOf(part) {
  const fields = Object.fromEntries(part.split("\n").map((line) => [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 2)]));
  return { kind: fields.event, id: fields.id, data: JSON.parse(fields.data) };
}

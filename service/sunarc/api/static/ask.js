// Questions to the API, with the token where reading needs one; it is kept in this tab alone.
const KEPT = "sunarc-token";
const SLOW_MS = 10000;

export class NeedsToken extends Error {}

export const keepToken = (token) => sessionStorage.setItem(KEPT, token);

async function fetched(path, how = {}) {
  const token = sessionStorage.getItem(KEPT);
  const headers = { ...how.headers, ...(token ? { authorization: `Bearer ${token}` } : {}) };
  const answer = await fetch(path, { ...how, headers, signal: AbortSignal.timeout(SLOW_MS) });
  if (answer.status === 401) throw new NeedsToken(path);
  if (answer.status === 404) return null;
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer;
}

// What a path answers; null where there is nothing yet.
export const ask = async (path) => (await fetched(path))?.json() ?? null;

// An image as an address that an element can show; whoever asked gives it back with URL.revokeObjectURL.
export async function askImage(path) {
  const answer = await fetched(path);
  return answer ? URL.createObjectURL(await answer.blob()) : null;
}

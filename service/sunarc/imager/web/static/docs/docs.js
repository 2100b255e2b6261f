// The API's document as a page: nothing is asked but /openapi.json.
import { ask, NeedsToken } from "../ask.js";
import { $, node } from "../draw.js";

const DEPTH = 4; // of nested objects that are listed
let schemas = {};

const resolved = (schema) => (schema?.$ref ? schemas[schema.$ref.split("/").at(-1)] ?? {} : schema ?? {});
const variants = (schema) => (schema.anyOf ?? schema.oneOf ?? [schema]).map(resolved);

function typeOf(schema) {
  return variants(resolved(schema)).map((one) => {
    if (one.enum ?? one.const) return (one.enum ?? [one.const]).map((value) => JSON.stringify(value)).join(" | ");
    if (one.type === "array") return `[${typeOf(one.items)}]`;
    return [one.type ?? "any", one.format && `(${one.format})`, ...limits(one)].filter(Boolean).join(" ");
  }).join(" or ");
}

function limits(schema) {
  const signs = { minimum: "≥", exclusiveMinimum: ">", maximum: "≤", exclusiveMaximum: "<" };
  return Object.entries(signs).filter(([key]) => schema[key] !== undefined).map(([key, sign]) => `${sign} ${schema[key]}`);
}

function rowsOf(schema, prefix = "", depth = 0) {
  return variants(resolved(schema)).flatMap((one) => {
    const inner = one.type === "array" ? resolved(one.items) : one;
    return Object.entries(inner.properties ?? {}).flatMap(([name, part]) => {
      const below = depth < DEPTH ? rowsOf(part, `${prefix}${name}.`, depth + 1) : [];
      return [[`${prefix}${name}`, typeOf(part), part.description ?? resolved(part).description ?? ""], ...below];
    });
  });
}

function table(title, rows) {
  if (!rows.length) return [];
  const made = document.createElement("table");
  for (const cells of rows) {
    const row = made.insertRow();
    row.append(node("td", cells[0]), node("td", cells[1]), node("td", cells[2]));
  }
  const wide = node("div", "", "wide");
  wide.tabIndex = 0;
  wide.setAttribute("role", "group"); // landmarks would need a name each
  wide.setAttribute("aria-label", title);
  wide.append(made);
  return [node("h4", title), wide];
}

function exampleOf(schema, depth = 0) {
  const one = variants(resolved(schema)).find((each) => each.type !== "null") ?? {};
  const given = resolved(schema).examples ?? one.examples;
  if (given?.length) return given[0];
  if (one.enum ?? one.const) return (one.enum ?? [one.const])[0];
  if (one.type === "array") return depth < DEPTH ? [exampleOf(one.items, depth + 1)] : [];
  if (!one.properties || depth >= DEPTH) return { string: "", number: 0, integer: 0, boolean: true }[one.type] ?? null;
  return Object.fromEntries(Object.entries(one.properties).map(([name, part]) => [name, exampleOf(part, depth + 1)]));
}

function sample(text) {
  const made = node("pre", text);
  made.tabIndex = 0; // it scrolls
  return made;
}

function bodies(title, content) {
  return Object.entries(content ?? {}).flatMap(([type, { schema, example }]) => {
    const rows = type.endsWith("json") ? rowsOf(schema) : [];
    const shown = example ?? (rows.length ? exampleOf(schema) : undefined);
    const text = typeof shown === "string" ? shown : JSON.stringify(shown, null, 1);
    return [node("p", `${title}: ${type}`), ...(shown === undefined ? [] : [sample(text)]), ...table(`${title}: fields`, rows)];
  });
}

function operation(path, method, one) {
  const made = node("section", "", "operation");
  made.id = one.operationId;
  const title = node("h3", "");
  title.append(node("span", method.toUpperCase(), "method"), ` ${path}`);
  made.append(title, node("p", one.description ?? one.summary ?? "", "text"));
  made.append(...table("Parameters", (one.parameters ?? []).map((each) => [`${each.name} (${each.in}${each.required ? ", required" : ""})`, typeOf(each.schema), each.description ?? ""])));
  if (one.requestBody) made.append(node("h4", "Request"), ...bodies("Body", one.requestBody.content));
  made.append(node("h4", "Answers"));
  for (const [status, answer] of Object.entries(one.responses)) {
    made.append(node("p", `${status}: ${answer.description}`));
    if (status.startsWith("2")) {
      made.append(...bodies("Body", answer.content), ...table("Headers", Object.entries(answer.headers ?? {}).map(([name, header]) => [name, typeOf(header.schema), header.description ?? ""])));
    }
  }
  return made;
}

function show(document_) {
  schemas = document_.components.schemas;
  $("version").textContent = document_.info.version;
  $("about").textContent = document_.info.description;
  const byTag = new Map();
  for (const [path, methods] of Object.entries(document_.paths)) {
    for (const [method, one] of Object.entries(methods)) {
      const tag = one.tags?.[0] ?? "other";
      byTag.set(tag, [...(byTag.get(tag) ?? []), [path, method, one]]);
    }
  }
  for (const [tag, operations] of byTag) {
    const about = document_.tags?.find(({ name }) => name === tag)?.description;
    $("routes").append(node("h2", tag));
    for (const [path, method, one] of operations) {
      const link = node("a", `${method.toUpperCase()} ${path}`);
      link.href = `#${one.operationId}`;
      $("routes").append(link);
    }
    $("operations").append(node("h2", about ? `${tag}: ${about}` : tag), ...operations.map((one) => operation(...one)));
  }
  if (location.hash) $(decodeURIComponent(location.hash.slice(1)))?.scrollIntoView();
}

// The routes whose names, fields or texts have every word that is asked for.
function search() {
  const words = $("search").value.toLowerCase().split(/\s+/).filter(Boolean);
  let found = 0;
  for (const one of $("operations").querySelectorAll(".operation")) {
    const text = one.textContent.toLowerCase();
    one.hidden = !words.every((word) => text.includes(word));
    $("routes").querySelector(`a[href="#${one.id}"]`).hidden = one.hidden;
    found += Number(!one.hidden);
  }
  $("found").textContent = words.length ? `${found} ${found === 1 ? "route" : "routes"}` : "";
}

$("search").addEventListener("input", search);
$("search-form").addEventListener("submit", (event) => event.preventDefault());

try {
  show(await ask("/openapi.json"));
} catch (error) {
  $("about").textContent = error instanceof NeedsToken ? "Reading needs a token: give it on the dashboard, in this tab, and come back." : "The service does not answer.";
}

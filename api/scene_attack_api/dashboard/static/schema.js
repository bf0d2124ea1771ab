// Reads the JSON schema of a request: what kind of field a value needs, and the value that a field's text means.

// The schema with its reference followed; what stands beside the reference stays.
export function resolved(schema, defs) {
  if (!schema.$ref) return schema;
  const { $ref, ...own } = schema;
  return { ...defs[$ref.split("/").pop()], ...own };
}

// What to show for a schema: { kind, schema, optional }. Kinds: object, list, tuple, choice, check, number, text, json.
export function fieldOf(given, defs) {
  let schema = resolved(given, defs);
  let optional = false;
  if (schema.anyOf) {
    const rest = schema.anyOf.filter((one) => one.type !== "null");
    optional = rest.length < schema.anyOf.length;
    const { anyOf, ...own } = schema;
    const only = rest.length === 1 ? resolved(rest[0], defs) : null;
    if (!only) return { kind: "json", schema, optional };
    schema = { ...only, ...own };
  }
  if (schema.enum) return { kind: "choice", schema, optional };
  if (schema.type === "object") return { kind: schema.properties ? "object" : "json", schema, optional };
  if (schema.type === "boolean") return { kind: "check", schema, optional };
  if (schema.type === "array") {
    if (schema.prefixItems) return { kind: "tuple", schema, optional };
    const items = resolved(schema.items ?? {}, defs);
    return { kind: items.properties ? "list" : "json", schema, optional };
  }
  if (schema.type === "number" || schema.type === "integer") return { kind: "number", schema, optional };
  return { kind: schema.type === "string" ? "text" : "json", schema, optional };
}

// The value of a JSON text. Integers that a number cannot hold stay as they are written, in browsers that can do so.
export function parsed(text) {
  return JSON.parse(text, (_, value, context) => (isRounded(value) && context?.source ? JSON.rawJSON(context.source) : value));
}

const isRounded = (value) => Number.isInteger(value) && !Number.isSafeInteger(value);

// The value that a text means. What is no number or no JSON stays a text: the service says what is wrong with it.
export function read(text, kind) {
  const trimmed = text.trim();
  if (trimmed === "") return undefined;
  if (kind === "text" || kind === "choice") return text;
  try {
    const value = parsed(trimmed);
    return kind !== "number" || typeof value === "number" || JSON.isRawJSON?.(value) ? value : text;
  } catch {
    return kind === "number" && Number.isFinite(Number(trimmed)) ? Number(trimmed) : text; // such as .5
  }
}

// The text of a value in a field.
export function written(value, kind) {
  if (value === undefined || value === null) return "";
  if (typeof value === "string") return value;
  if (JSON.isRawJSON?.(value)) return value.rawJSON;
  return kind === "number" ? String(value) : JSON.stringify(value);
}

export function at(value, path) {
  return path.reduce((found, key) => (found === null || found === undefined ? undefined : found[key]), value);
}

// Sets a value in nested objects and lists, or removes it if it is undefined; makes what lies between.
export function put(value, path, found) {
  let parent = value;
  for (const [k, key] of path.slice(0, -1).entries()) {
    if (parent[key] === null || typeof parent[key] !== "object") {
      if (found === undefined) return;
      parent[key] = typeof path[k + 1] === "number" ? [] : {};
    }
    parent = parent[key];
  }
  if (found === undefined) delete parent[path.at(-1)];
  else parent[path.at(-1)] = found;
}

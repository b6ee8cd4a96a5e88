/** JSON Schemas of jobs, from the service's OpenAPI document, and the values that they fill in. */

import { get } from "./api.js";

let document;

/** The schemas of the OpenAPI document, asked for once. */
export async function schemas() {
  document ??= get("/openapi.json").then(
    (found) => found.components.schemas,
    (error) => {
      document = undefined;
      throw error;
    },
  );
  return document;
}

/** What a reference stands for; other members of the schema (a default, a description) take precedence. */
export function resolve(schema, all) {
  const reference = schema.$ref || (schema.allOf?.length === 1 && schema.allOf[0].$ref);
  if (!reference) return schema;
  const found = all[reference.split("/").at(-1)] || {};
  const { $ref, allOf, ...own } = schema;
  return { ...resolve(found, all), ...own };
}

/** The form of a value that may be null as well, and whether it may. */
export function withoutNull(schema, all) {
  const whole = resolve(schema, all);
  const forms = whole.anyOf?.filter((form) => form.type !== "null");
  if (!forms) return { schema: whole, isNullable: false };
  const isNullable = forms.length < whole.anyOf.length;
  if (forms.length > 1) return { schema: { ...whole, anyOf: forms }, isNullable };
  const { anyOf, ...own } = whole;
  return { schema: { ...resolve(forms[0], all), ...own }, isNullable };
}

/** A document with the defaults of its schema where it says nothing. */
export function filled(schema, all, said) {
  const { schema: own } = withoutNull(schema, all);
  if (said === null || (said !== undefined && (typeof said !== "object" || Array.isArray(said)))) return said;
  if (!own.properties) return said ?? own.default;
  if (said === undefined && own.default === null) return null;
  const given = said ?? {};
  const names = new Set([...Object.keys(own.properties), ...Object.keys(given)]);
  return Object.fromEntries(
    [...names].map((name) => [name, own.properties[name] ? filled(own.properties[name], all, given[name]) : given[name]]),
  );
}

/** A document as pairs of a path and a value; lists are values. */
export function flat(document, path = []) {
  if (document === null || typeof document !== "object" || Array.isArray(document) || !Object.keys(document).length) {
    return [[path.join("."), document]];
  }
  return Object.entries(document).flatMap(([name, value]) => flat(value, [...path, name]));
}

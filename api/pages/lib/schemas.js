/** JSON Schemas of jobs, from the service's OpenAPI document. */

import { get } from "./api.js";

let document;

/** The OpenAPI document, asked for once. */
export async function openapi() {
  document ??= get("/openapi.json").catch((error) => {
    document = undefined;
    throw error;
  });
  return document;
}

/** Its schemas by name. */
export const schemas = async () => (await openapi()).components.schemas;

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

/** JSON Schemas of jobs, from the service's OpenAPI document, and the fields that they describe. */

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

/** The form of an object for which `true` may stand, as its defaults; null where there is no such choice. */
export function orTrue({ anyOf = [] }, all) {
  const form = anyOf.length === 2 && anyOf.some(({ type }) => type === "boolean") && resolve(anyOf.find(({ type }) => type !== "boolean"), all);
  return form && form.properties ? form : null;
}

/**
 * The forms that a list's items may have, by the value of the field that tells them apart, `tag`; null where items
 * are no objects. Items of a single form may have no such field.
 * @returns {{tag: string, forms: Map<string, object>} | null}
 */
export function itemsOf(schema, all) {
  const items = schema.type === "array" && schema.items ? resolve(schema.items, all) : {};
  if (items.discriminator) {
    const { propertyName: tag, mapping } = items.discriminator;
    return { tag, forms: new Map(Object.entries(mapping).map(([kind, $ref]) => [kind, resolve({ $ref }, all)])) };
  }
  if (!items.properties) return null;
  const [tag, field] = Object.entries(items.properties).find(([, { const: kind }]) => kind !== undefined) || ["", {}];
  return { tag, forms: new Map([[field.const ?? "", items]]) };
}

/** What an object says besides the defaults of its schema; its tag stays. */
export const beyondDefaults = (value, { properties }) =>
  Object.fromEntries(Object.entries(value).filter(([name, one]) => properties[name]?.const !== undefined || !isSame(one, properties[name]?.default)));

const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);

/** The bounds of a number, in words; "" where there are none that one would meet. */
export function boundsOf({ type, minimum, exclusiveMinimum, maximum, exclusiveMaximum }) {
  if (type !== "number" && type !== "integer") return "";
  const isNear = (bound) => bound !== undefined && Math.abs(bound) < 1e6;
  const low = isNear(minimum) ? `at least ${minimum}` : isNear(exclusiveMinimum) ? `more than ${exclusiveMinimum}` : "";
  const high = isNear(maximum) ? `at most ${maximum}` : isNear(exclusiveMaximum) ? `less than ${exclusiveMaximum}` : "";
  return [low, high].filter(Boolean).join(", ");
}

// `kind` says what the other fields are; name, labels and note change no result.
const FIXED = new Set(["kind", "name", "labels", "note", "environment"]);
const OPTIONS = "environment.options.";

/** The devices that a job may run on. */
export function devicesOf(job) {
  const { accelerator = "any", gpus = 1 } = job.resources || {};
  return gpus > 1 ? ["gpu"] : accelerator === "any" ? ["cpu", "gpu"] : [accelerator];
}

/** What a job's hyperparameters are where it says nothing, on the first of its devices. */
const plannedOf = (job, environment) => environment?.defaults?.[job.algorithm?.kind || "ppo"]?.[devicesOf(job)[0]];

/**
 * @param {object} environment As `GET /environments/{id}` shows it; without it, its options are missing.
 * @returns {{path: string, schema: object, isNullable: boolean, now: any}[]} now: the value that the job has.
 */
export function fieldsOf(job, all, environment) {
  const schema = all[job.kind === "rollout" ? "RolloutSpec" : "TrainSpec"];
  const planned = { algorithm: { kind: "ppo", ...plannedOf(job, environment) } };
  const own = leaves(schema, all, job, planned, "").filter(({ path }) => !FIXED.has(path.split(".")[0]));
  const options = environment?.options;
  if (!options?.properties) return own;
  const here = { ...all, ...options.$defs };
  return [...own, ...withParts(options, here, job.environment?.options, undefined, OPTIONS)];
}

/** The fields of an object; each that is an object itself is followed by its own. */
function withParts(schema, all, said, planned, prefix) {
  return properties(schema, all, said, planned, prefix).flatMap((field) => {
    const name = field.path.slice(prefix.length);
    const form = field.now === null ? null : formOf(field.schema, all, field.now);
    return form ? [field, ...withParts(form, all, said?.[name], field.planned, `${field.path}.`)] : [field];
  });
}

/** The fields of an object, and of the objects in it. */
function leaves(schema, all, said, planned, prefix) {
  return properties(schema, all, said, planned, prefix).flatMap((field) => {
    const name = field.path.slice(prefix.length);
    const form = field.now === null ? null : formOf(field.schema, all, field.now);
    if (!form) return name === "kind" ? [] : [field];
    return leaves(form, all, said?.[name], field.planned, `${field.path}.`);
  });
}

/** The fields of an object alone. */
function properties(schema, all, said, planned, prefix) {
  return Object.entries(schema.properties || {}).map(([name, given]) => {
    const { schema: inner, isNullable } = withoutNull(given, all);
    const expected = planned?.[name] ?? given.default ?? inner.default;
    const now = said?.[name] !== undefined ? said[name] : expected;
    return { path: `${prefix}${name}`, schema: inner, isNullable, now, planned: expected };
  });
}

/** The schema of an object that has fields of its own; of several forms, the one that its value says. */
function formOf(schema, all, now) {
  if (schema.properties) return schema;
  if (!schema.oneOf || !schema.discriminator) return null;
  const { mapping, propertyName } = schema.discriminator;
  const kind = now?.[propertyName] ?? schema.default?.[propertyName]; // A job may leave it out.
  return resolve({ $ref: mapping[kind] || Object.values(mapping)[0] }, all);
}

const formsOf = (schema) => schema.anyOf || [schema];

/** Whether its values are numbers, so that a range may say them. */
export const isNumeric = ({ schema }) => formsOf(schema).every(({ type, enum: few }) => !few && ["integer", "number"].includes(type));

/** Whether it takes numbers that are not whole. */
export const takesFractions = ({ schema }) => formsOf(schema).some(({ type }) => type === "number");

/** All values that it can have, if they are few. */
export function choicesOf({ schema, isNullable }) {
  const found = schema.enum || (schema.type === "boolean" ? [true, false] : null);
  return found && isNullable ? [...found, null] : found;
}

/** What it takes, in a word or two. */
export function kindOf(field) {
  if (choicesOf(field)) return field.schema.type === "boolean" ? "yes or no" : "one of a few";
  if (isNumeric(field)) return takesFractions(field) ? "number" : "whole number";
  return { string: "text", array: "list", object: "object" }[field.schema.type] || "value";
}

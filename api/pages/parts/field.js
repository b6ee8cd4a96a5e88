/** A field of a form, or a group of them, as a JSON Schema describes it. */

import { at, put } from "../lib/draft.js";
import { html, useId, useState } from "../lib/html.js";
import { beyondDefaults, boundsOf, itemsOf, orTrue, resolve, withoutNull } from "../lib/schemas.js";
import { Prose } from "./elements.js";
import { ByName, Names, partsNamed } from "./names.js";
import { Rows } from "./rows.js";

const NULL = "null";

/**
 * @param {{all: object, document: object, set: (path: string[], value: any) => void, errors: object[], parts?: object,
 *   path: string[], schema: object, planned?: any, isFilled?: boolean, isOpen?: boolean, isRequired?: boolean,
 *   none?: string, suggestions?: string[]}} field
 *   planned: the value that the service takes if none is said; by default the schema's. isFilled: of an object, it
 *   takes single fields from it as well; otherwise an object that is said replaces it.
 *   none: what it means to choose no form. suggestions: some values; others may be typed.
 *   parts: the names of a model's parts, by kind.
 */
export function Field(field) {
  const { all, path, schema: given } = field;
  const { schema, isNullable } = withoutNull(given, all);
  const planned = field.planned === undefined ? given.default ?? schema.default : field.planned;
  const inner = { ...field, schema, isNullable, planned, name: path.at(-1) };
  if (schema.const !== undefined && path.length > 1) return null;
  if (schema.oneOf && schema.discriminator) return html`<${Choice} ...${inner} />`;
  if (schema.properties) return html`<${Group} ...${inner} />`;
  const whole = orTrue(schema, all);
  if (whole) return html`<${Group} ...${inner} schema=${{ ...whole, description: schema.description }} isBare />`;
  if (itemsOf(schema, all)) return html`<${Rows} ...${inner} items=${itemsOf(schema, all)} />`;
  return html`<${Input} ...${inner} />`;
}

/** What a field hands on to those in it. */
export const shared = ({ all, document, set, errors, parts, isFilled }) => ({ all, document, set, errors, parts, isFilled });

/** The errors at exactly this place. */
export const errorsAt = (errors, path) => errors.filter(({ pointer }) => pointer === `/${path.join("/")}`);

/** Those in it. */
export const errorsBelow = (errors, path) => errors.filter(({ pointer }) => pointer.startsWith(`/${path.join("/")}/`));

export const Wrong = ({ errors }) => errors.map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`);

/** `set` for the fields in an object that nobody has said yet: the first of them says its defaults, too. */
function settingWhole({ document, set, path, schema, planned, isFilled }) {
  if (isFilled || !planned || at(document, path) !== undefined) return set;
  return beginning(beyondDefaults(planned, schema), path, set);
}

/** `set` that puts a field's value into a whole object; without a value nothing is said. */
const beginning = (whole, path, set) => (inner, value) =>
  value !== undefined && set(path, inner.length > path.length ? put(whole, inner.slice(path.length), value) : value);

/** `set` for the fields of an object for which `true` stands while nothing is said in it. */
const settingBare = ({ document, set, path }) => (inner, value) => {
  const next = put(Object(at(document, path)), inner.slice(path.length), value);
  set(path, Object.keys(next).length ? next : true);
};

// Of a long group, the fields after these are folded.
const SHOWN = 10;

/**
 * Several fields; folded unless the document says something about them or has an error there.
 * first: the names of those that come first. numShown: how many are not folded. isBare: `true` stands for it.
 */
export function Group(field) {
  const { document, set, errors, path, schema, name, isNullable, isOpen, isFilled, isBare, numShown = SHOWN } = field;
  const said = at(document, path);
  const isOff = said === null || said === false || (said === undefined && isNullable && field.planned === null);
  const has = said !== undefined || errors.some(({ pointer }) => pointer.startsWith(`/${path.join("/")}`));
  // An object that is said replaces what was planned.
  const planned = said === undefined || isFilled ? field.planned : undefined;
  const first = field.first || [];
  const known = Object.keys(schema.properties).filter((each) => schema.properties[each].const === undefined);
  const names = [...first.filter((each) => known.includes(each)), ...known.filter((each) => !first.includes(each))];
  const handed = { ...shared(field), set: isBare ? settingBare(field) : settingWhole(field) };
  const draw = (each) => html`<${Field} key=${each} ...${handed} path=${[...path, each]} schema=${schema.properties[each]} planned=${planned?.[each]} isRequired=${schema.required?.includes(each)} />`;
  const rest = names.slice(numShown);
  const isRestSaid = rest.some((each) => said?.[each] !== undefined || errors.some(({ pointer }) => pointer.startsWith(`/${[...path, each].join("/")}`)));
  // Those that no field will show.
  const elsewhere = errorsBelow(errors, path).filter(({ pointer }) => !known.includes(pointer.split("/")[path.length + 1]));
  const content = html`
    ${schema.description && html`<p class="facts"><${Prose} text=${schema.description} /></p>`}
    <${Wrong} errors=${[...errorsAt(errors, path), ...elsewhere]} />
    ${isNullable && html`<label class="tools"><span><input type="checkbox" checked=${!isOff} onChange=${(event) => set(path, offOrOn(event.target.checked, field.planned, isBare || {}))} /> ${" "}with ${words(name)}</span></label>`}
    ${!isOff && html`<div class="fields">${names.slice(0, numShown).map(draw)}</div>`}
    ${!isOff && rest.length > 0 && html`<details open=${isRestSaid}><summary>${rest.length} more</summary><div class="fields">${rest.map(draw)}</div></details>`}
  `;
  if (isOpen) return html`<div class="field wide">${content}</div>`;
  return html`<details class="field wide" open=${has}><summary>${words(name)}</summary>${content}</details>`;
}

/** What to say so that an optional part is there, or is not. */
const offOrOn = (isOn, planned, on) => (planned === null ? (isOn ? on : undefined) : isOn ? undefined : null);

/** One of several forms, told apart by a field such as `kind`. */
function Choice(field) {
  const { all, document, set, errors, path, schema, name, isNullable, isFilled } = field;
  const tag = schema.discriminator.propertyName;
  const forms = schema.discriminator.mapping;
  const said = at(document, path);
  const plannedForm = field.planned?.[tag];
  const chosen = said === null ? "" : said?.[tag] ?? (isFilled || said === undefined ? plannedForm ?? (isNullable ? "" : Object.keys(forms)[0]) : "");
  const form = forms[chosen] && resolve({ $ref: forms[chosen] }, all);
  const id = useId();
  // The algorithm's own kind need not be said.
  const begun = said === undefined && !(isFilled && path.length === 1) && { ...(chosen === plannedForm && !isFilled && beyondDefaults(field.planned, form)), [tag]: chosen };
  const setField = begun ? beginning(begun, path, set) : set;
  const choose = ({ target }) => set(path, target.value === NULL ? null : target.value ? { [tag]: target.value } : undefined);
  return html`<div class="field wide">
    <label for=${id}>${words(name)}</label>
    <select id=${id} value=${isNullable && said === undefined ? "" : said === null ? NULL : chosen} onChange=${choose}>
      ${isNullable && html`<option value="">${field.none || (plannedForm ? `default: ${plannedForm}` : "by default")}</option>`}
      ${isNullable && (plannedForm || said === null) && html`<option value=${NULL}>none</option>`}
      ${Object.keys(forms).map((one) => html`<option value=${one}>${one}</option>`)}
    </select>
    ${schema.description && html`<p class="facts"><${Prose} text=${schema.description} /></p>`}
    ${!form && html`<${Wrong} errors=${[...errorsAt(errors, path), ...errorsBelow(errors, path)]} />`}
    ${form && html`<${Group} ...${shared(field)} ...${{ path, name }} schema=${form} isOpen
      set=${setField} first=${field.firstFields?.(chosen)}
      planned=${isFilled ? field.plannedFields?.(chosen) : chosen === plannedForm ? field.planned : undefined} />`}
  </div>`;
}

function Input(field) {
  const { document, set, errors, path, schema, planned, isNullable, isRequired, name } = field;
  const id = useId();
  const said = at(document, path);
  const wrong = errorsAt(errors, path).concat(errorsBelow(errors, path));
  const about = [schema.description, boundsOf(schema) && `${capital(boundsOf(schema))}.`].filter(Boolean).join(" ");
  const described = [about && `${id}-about`, wrong.length && `${id}-error`].filter(Boolean).join(" ");
  const common = {
    id,
    "aria-describedby": described || undefined,
    "aria-invalid": wrong.length ? "true" : undefined,
    "aria-required": isRequired ? "true" : undefined,
  };
  const names = field.suggestions || partsNamed(field.parts, name);
  const widget = { common, label: words(name), said, planned, schema, isNullable, isRequired, suggestions: names, onChange: (value) => set(path, value) };
  return html`<div class="field">
    ${isTicked(schema) ? html`<span class="label-like" id="${id}-label">${words(name)}</span>` : html`<label for=${id}>${words(name)}</label>`}
    <${widgetOf(schema, said)} ...${widget} />
    ${about && html`<p class="facts" id="${id}-about"><${Prose} text=${about} /></p>`}
    ${wrong.length > 0 && html`<p class="error" id="${id}-error"><${Prose} text=${wrong.map(({ detail }) => detail).join(" ")} /></p>`}
  </div>`;
}

const capital = (text) => text[0].toUpperCase() + text.slice(1);

const isTicked = ({ type, items }) => type === "array" && Boolean(items?.enum);

/** What cannot be shown in a widget of its own, such as text where a list belongs, is text. */
function widgetOf(schema, said) {
  if (schema.enum || schema.type === "boolean") return Select;
  if (isTicked(schema) && (said === undefined || said === null || Array.isArray(said))) return Ticks;
  const areNames = schema.type === "array" && schema.items?.type === "string";
  if (areNames && (said === undefined || said === null || (Array.isArray(said) && said.every((one) => typeof one === "string")))) return Names;
  const areByName = schema.type === "object" && schema.additionalProperties?.type === "number";
  if (areByName && (said === undefined || said === null || (typeof said === "object" && !Array.isArray(said)))) return ByName;
  return Text;
}

function Select({ common, said, planned, schema, onChange }) {
  const options = schema.enum || [true, false];
  const texts = options.map(String);
  const choose = ({ target }) => onChange(target.value === "" ? undefined : options[texts.indexOf(target.value)]);
  return html`<select ...${common} value=${said === undefined ? "" : String(said)} onChange=${choose}>
    <option value="">${planned === undefined ? "not set" : `default: ${planned}`}</option>
    ${texts.map((text) => html`<option value=${text}>${text}</option>`)}
  </select>`;
}

/** Some of a few words. */
function Ticks({ common, said, planned, schema, onChange }) {
  const chosen = said ?? planned ?? [];
  const tick = (word) => () => onChange(chosen.includes(word) ? chosen.filter((one) => one !== word) : schema.items.enum.filter((one) => one === word || chosen.includes(one)));
  return html`<div class="ticks" role="group" aria-labelledby="${common.id}-label" aria-describedby=${common["aria-describedby"]}>${schema.items.enum.map(
    (word) => html`<label class="tick" key=${word}><input type="checkbox" checked=${chosen.includes(word)} onChange=${tick(word)} /> ${words(word)}</label>`,
  )}</div>`;
}

/** Text for a number, a word, a list or an object; what cannot be read stays text, and the service says why. */
function Text({ common, said, planned, schema, isNullable, isRequired, suggestions, onChange }) {
  const [typed, setTyped] = useState(null); // What was typed while it is being typed.
  const isText = schema.type === "string";
  const shown = typed ?? (said === undefined ? "" : isText && said !== null ? said : JSON.stringify(said));
  const type = ({ target }) => {
    setTyped(target.value);
    onChange(read(target.value, schema, isNullable));
  };
  const isNumber = schema.type === "integer" || schema.type === "number";
  const list = suggestions?.length && !isNumber ? `${common.id}-list` : undefined;
  return html`<input ...${common} type="text" list=${list} inputmode=${isNumber ? "decimal" : undefined} value=${shown}
    placeholder=${planned === undefined || planned === null ? example(schema) || (isRequired ? "required" : "") : isText ? planned : JSON.stringify(planned)}
    onInput=${type} onBlur=${() => setTyped(null)} />
    ${list && html`<datalist id=${list}>${suggestions.map((one) => html`<option key=${one} value=${one}></option>`)}</datalist>`}`;
}

function read(text, { type }, isNullable) {
  if (text === "") return undefined;
  if (isNullable && text === NULL) return null;
  if (type === "string") return text;
  // A list's brackets may be left out.
  for (const one of type === "array" && !text.trim().startsWith("[") ? [`[${text}]`] : [text]) {
    try {
      return JSON.parse(one);
    } catch {}
  }
  return text;
}

function example(schema) {
  if (schema.examples?.length) return typeof schema.examples[0] === "string" ? schema.examples[0] : JSON.stringify(schema.examples[0]);
  if (schema.type === "array") return "[…]";
  return schema.type === "object" ? "{…}" : "";
}

export const words = (name) => name.replaceAll("_", " ");

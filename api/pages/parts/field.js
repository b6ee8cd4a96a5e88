/** A field of a form, or a group of them, as a JSON Schema describes it. */

import { at } from "../lib/draft.js";
import { html, useId, useState } from "../lib/html.js";
import { resolve, withoutNull } from "../lib/schemas.js";
import { Prose } from "./elements.js";

const NULL = "null";

/**
 * @param {{all: object, document: object, set: (path: string[], value: any) => void, errors: object[],
 *   path: string[], schema: object, planned?: any, isOpen?: boolean, none?: string, suggestions?: string[]}} field
 *   planned: the value that the service takes if none is said; by default the schema's.
 *   none: what it means to choose no form. suggestions: some values; others may be typed.
 */
export function Field(field) {
  const { all, path, schema: given } = field;
  const { schema, isNullable } = withoutNull(given, all);
  const planned = field.planned === undefined ? given.default ?? schema.default : field.planned;
  const inner = { ...field, schema, isNullable, planned, name: path.at(-1) };
  if (schema.const !== undefined && path.length > 1) return null;
  if (schema.oneOf && schema.discriminator) return html`<${Choice} ...${inner} />`;
  if (schema.properties) return html`<${Group} ...${inner} />`;
  return html`<${Input} ...${inner} />`;
}

/** The errors at exactly this place. */
const errorsAt = (errors, path) => errors.filter(({ pointer }) => pointer === `/${path.join("/")}`);

// Of a long group, the fields after these are folded.
const SHOWN = 10;

/** Several fields; folded unless the document says something about them or has an error there. */
function Group(field) {
  const { all, document, set, errors, path, schema, name, isNullable, isOpen, planned } = field;
  const said = at(document, path);
  const isOff = said === null || (said === undefined && isNullable && planned === null);
  const has = said !== undefined || errors.some(({ pointer }) => pointer.startsWith(`/${path.join("/")}`));
  const first = field.first || [];
  const known = Object.keys(schema.properties).filter((each) => schema.properties[each].const === undefined);
  const names = [...first.filter((each) => known.includes(each)), ...known.filter((each) => !first.includes(each))];
  const draw = (each) => html`<${Field} key=${each} ...${{ all, document, set, errors }} path=${[...path, each]} schema=${schema.properties[each]} planned=${planned?.[each]} />`;
  const rest = names.slice(SHOWN);
  const isRestSaid = rest.some((each) => said?.[each] !== undefined || errors.some(({ pointer }) => pointer.startsWith(`/${[...path, each].join("/")}`)));
  const content = html`
    ${schema.description && html`<p class="facts"><${Prose} text=${schema.description} /></p>`}
    ${errorsAt(errors, path).map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
    ${isNullable && html`<label class="tools"><span><input type="checkbox" checked=${!isOff} onChange=${(event) => set(path, offOrOn(event.target.checked, planned))} /> ${" "}with ${words(name)}</span></label>`}
    ${!isOff && html`<div class="fields">${names.slice(0, SHOWN).map(draw)}</div>`}
    ${!isOff && rest.length > 0 && html`<details open=${isRestSaid}><summary>${rest.length} more</summary><div class="fields">${rest.map(draw)}</div></details>`}
  `;
  if (isOpen) return html`<div class="field wide">${content}</div>`;
  return html`<details class="field wide" open=${has}><summary>${words(name)}</summary>${content}</details>`;
}

/** What to say so that an optional part is there, or is not. */
const offOrOn = (isOn, planned) => (planned === null ? (isOn ? {} : undefined) : isOn ? undefined : null);

/** One of several forms, told apart by a field such as `kind`. */
function Choice(field) {
  const { all, document, set, errors, path, schema, name, isNullable } = field;
  const tag = schema.discriminator.propertyName;
  const forms = schema.discriminator.mapping;
  const chosen = at(document, [...path, tag]) ?? field.planned?.[tag] ?? (isNullable ? "" : Object.keys(forms)[0]);
  const id = useId();
  const choose = ({ target }) => set(path, target.value ? { [tag]: target.value } : undefined);
  return html`<div class="field wide">
    <label for=${id}>${words(name)}</label>
    <select id=${id} value=${chosen} onChange=${choose}>
      ${isNullable && html`<option value="">${field.none || "by default"}</option>`}
      ${Object.keys(forms).map((form) => html`<option value=${form}>${form}</option>`)}
    </select>
    ${schema.description && html`<p class="facts"><${Prose} text=${schema.description} /></p>`}
    ${errorsAt(errors, path).map(({ detail }) => html`<p class="error"><${Prose} text=${detail} /></p>`)}
    ${forms[chosen] && html`<${Group} ...${{ all, document, set, errors, path, name }} schema=${resolve({ $ref: forms[chosen] }, all)} planned=${field.plannedFields?.(chosen)} first=${field.firstFields?.(chosen)} isOpen />`}
  </div>`;
}

function Input(field) {
  const { document, set, errors, path, schema, planned, isNullable, name } = field;
  const id = useId();
  const said = at(document, path);
  const wrong = errorsAt(errors, path).concat(errors.filter(({ pointer }) => isListItem(pointer, path)));
  const described = [schema.description && `${id}-about`, wrong.length && `${id}-error`].filter(Boolean).join(" ");
  const common = { id, "aria-describedby": described || undefined, "aria-invalid": wrong.length ? "true" : undefined };
  return html`<div class="field">
    <label for=${id}>${words(name)}</label>
    ${schema.enum || schema.type === "boolean"
      ? html`<${Select} common=${common} said=${said} planned=${planned} options=${schema.enum || [true, false]} onChange=${(value) => set(path, value)} />`
      : html`<${Text} common=${common} said=${said} planned=${planned} schema=${schema} isNullable=${isNullable} suggestions=${field.suggestions} onChange=${(value) => set(path, value)} />`}
    ${schema.description && html`<p class="facts" id="${id}-about"><${Prose} text=${schema.description} /></p>`}
    ${wrong.length > 0 && html`<p class="error" id="${id}-error"><${Prose} text=${wrong.map(({ detail }) => detail).join(" ")} /></p>`}
  </div>`;
}

const isListItem = (pointer, path) => pointer.startsWith(`/${path.join("/")}/`);

function Select({ common, said, planned, options, onChange }) {
  const texts = options.map(String);
  const choose = ({ target }) => onChange(target.value === "" ? undefined : options[texts.indexOf(target.value)]);
  return html`<select ...${common} value=${said === undefined ? "" : String(said)} onChange=${choose}>
    <option value="">${planned === undefined ? "not set" : `default: ${planned}`}</option>
    ${texts.map((text) => html`<option value=${text}>${text}</option>`)}
  </select>`;
}

/** Text for a number, a word, a list or an object; what cannot be read stays text, and the service says why. */
function Text({ common, said, planned, schema, isNullable, suggestions, onChange }) {
  const [typed, setTyped] = useState(null); // What was typed while it is being typed.
  const isText = schema.type === "string";
  const shown = typed ?? (said === undefined ? "" : isText && said !== null ? said : JSON.stringify(said));
  const type = ({ target }) => {
    setTyped(target.value);
    onChange(read(target.value, isText, isNullable));
  };
  const isNumber = schema.type === "integer" || schema.type === "number";
  const list = suggestions?.length ? `${common.id}-list` : undefined;
  return html`<input ...${common} type="text" list=${list} inputmode=${isNumber ? "decimal" : undefined} value=${shown}
    placeholder=${planned === undefined || planned === null ? example(schema) : isText ? planned : JSON.stringify(planned)}
    onInput=${type} onBlur=${() => setTyped(null)} />
    ${list && html`<datalist id=${list}>${suggestions.map((one) => html`<option key=${one} value=${one}></option>`)}</datalist>`}`;
}

function read(text, isText, isNullable) {
  if (text === "") return undefined;
  if (isNullable && text === NULL) return null;
  if (isText) return text;
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}

function example(schema) {
  if (schema.examples?.length) return String(schema.examples[0]);
  if (schema.type === "array") return "[…]";
  return schema.type === "object" ? "{…}" : "";
}

const words = (name) => name.replaceAll("_", " ");

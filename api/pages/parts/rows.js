/** A list of objects, such as the terms of a reward: a row for each, to add, change, move and remove; or its JSON. */

import { at, parsed, put } from "../lib/draft.js";
import { html, useEffect, useId, useRef, useState } from "../lib/html.js";
import { beyondDefaults } from "../lib/schemas.js";
import { Prose } from "./elements.js";
import { errorsAt, errorsBelow, Group, shared, words, Wrong } from "./field.js";
import { KindSearch } from "./kind_search.js";

/** items: what `itemsOf` makes of the schema. */
export function Rows(field) {
  const { document, set, errors, path, schema, planned, name, items } = field;
  const said = at(document, path);
  const isOwn = Array.isArray(said);
  const rows = isOwn ? said : said === undefined && Array.isArray(planned) ? planned.map((row) => beyondDefaults(row, formOf(items, row) || { properties: {} })) : [];
  const wrong = [...errorsAt(errors, path), ...errorsBelow(errors, path)];
  const [isOpen, setOpen] = useState(said !== undefined);
  const [isText, setText] = useState(false);
  const [told, tell] = useState("");
  const isUnreadable = said !== undefined && said !== null && !isOwn;
  const change = (next) => set(path, next);
  const label = words(name);
  const write = (asText) => () => setText(asText);
  return html`<details class="field wide" open=${isOpen || wrong.length > 0} onToggle=${({ target }) => setOpen(target.open)}>
    <summary>${label} <span class="facts">${isUnreadable ? "" : summary(rows, items, isOwn || (said === null && planned !== null))}</span></summary>
    ${(isOpen || wrong.length > 0) && html`<div class="part" role="group" aria-label=${label}>
      ${schema.description && html`<p class="facts"><${Prose} text=${schema.description} /></p>`}
      <${Wrong} errors=${isText || isUnreadable ? wrong : errorsAt(errors, path)} />
      <div class="actions">
        <span class="actions" role="group" aria-label="How ${label} is written">
          <button type="button" aria-pressed=${!isText && !isUnreadable} disabled=${isUnreadable} onClick=${write(false)}>Rows</button>
          <button type="button" aria-pressed=${isText || isUnreadable} onClick=${write(true)}>JSON</button>
        </span>
        ${said !== undefined && html`<button type="button" class="plain" onClick=${() => change(undefined)}>Back to the default</button>`}
        ${!isOwn && !schema.minItems && (planned === null || rows.length > 0) && html`<button type="button" class="plain" onClick=${() => change([])}>None at all</button>`}
      </div>
      ${isText || isUnreadable
        ? html`<${AsText} label="${label} as JSON" value=${isUnreadable ? said : rows} isDefault=${said === undefined} change=${change} />`
        : html`<${Editor} ...${shared(field)} ...${{ path, items, rows, label, change, tell }} most=${schema.maxItems} />`}
      <p class="unseen" role="status">${told}</p>
    </div>`}
  </details>`;
}

const formOf = ({ tag, forms }, row) => (forms.size === 1 && !tag ? [...forms.values()][0] : forms.get(row[tag] ?? (forms.size === 1 ? [...forms.keys()][0] : "")));

const MOST_NAMED = 4;

function summary(rows, { tag }, isOwn) {
  if (!rows.length) return isOwn ? "none" : "by default";
  const kinds = tag ? `: ${rows.slice(0, MOST_NAMED).map((row) => row[tag]).join(", ")}${rows.length > MOST_NAMED ? ", …" : ""}` : "";
  return `${rows.length}${isOwn ? "" : " by default"}${kinds}`;
}

/** The rows' names that last while rows come, go and move, so that each keeps what it shows. */
function useNames(number) {
  const names = useRef([]);
  const next = useRef(0);
  while (names.current.length < number) names.current.push(next.current++);
  names.current.length = number;
  return { names, nextName: () => next.current };
}

function Editor({ path, items, rows, label, change, tell, most = Infinity, ...fields }) {
  const box = useRef();
  const { names, nextName } = useNames(rows.length);
  const [added, setAdded] = useState(null);
  const [toFocus, setFocus] = useState(null); // Selectors: the first that is there gets the focus after the next drawing.
  const title = (row, i) => (items.tag ? row[items.tag] : `${label} ${i + 1}`);
  const add = (kind) => {
    const form = items.forms.get(kind);
    setAdded(nextName());
    change([...rows, begun(form, items.tag, kind)]);
    tell(`${kind || label} was added as ${rows.length + 1}.`);
  };
  const remove = (i) => {
    names.current.splice(i, 1);
    change(rows.filter((_, place) => place !== i));
    setFocus([":scope > .adder :is(input, button)"]);
    tell(`${title(rows[i], i)} was removed.`);
  };
  const move = (i, by) => {
    const order = (list) => list.with(i, list[i + by]).with(i + by, list[i]);
    names.current = order(names.current);
    change(order(rows));
    const here = `:scope > .rows > [data-row="${names.current[i + by]}"] > .actions`;
    setFocus([`${here} [data-by="${by}"]:enabled`, `${here} [data-by]:enabled`]);
    tell(`${title(rows[i], i)} is now ${i + by + 1} of ${rows.length}.`);
  };
  useEffect(() => {
    if (!toFocus) return;
    toFocus.map((one) => box.current.querySelector(one)).find(Boolean)?.focus();
    setFocus(null);
  }, [toFocus]);
  // A field of a row that is shown by default makes the whole list the document's own.
  const set = (inner, value) => change(put(rows, inner.slice(path.length), value));
  const document = put(fields.document, path, rows);
  return html`<div class="part" ref=${box}>
    ${rows.length > 0 && html`<ol class="rows">${rows.map(
      (row, i) => html`<li key=${names.current[i]} data-row=${names.current[i]}>
        <${Row} ...${fields} document=${document} set=${set} path=${[...path, i]} items=${items} row=${row} title=${title(row, i)} label="${label} ${i + 1}: ${title(row, i)}" isNew=${names.current[i] === added} />
        <span class="actions" role="group" aria-label="${title(row, i)}, ${i + 1} of ${rows.length}">
          <button type="button" class="plain" data-by="-1" disabled=${i === 0} onClick=${() => move(i, -1)} aria-label="Move up" title="Move up">↑</button>
          <button type="button" class="plain" data-by="1" disabled=${i === rows.length - 1} onClick=${() => move(i, 1)} aria-label="Move down" title="Move down">↓</button>
          <button type="button" class="plain" onClick=${() => remove(i)} aria-label="Remove" title="Remove">✕</button>
        </span>
      </li>`,
    )}</ol>`}
    ${rows.length < most && html`<div class="adder">${items.forms.size > 1
      ? html`<${KindSearch} label="Add to ${label}" forms=${items.forms} taken=${rows.map((row) => row[items.tag])} choose=${add} />`
      : html`<button type="button" onClick=${() => add([...items.forms.keys()][0])}>Add ${[...items.forms.keys()][0] || `to ${label}`}</button>`}</div>`}
  </div>`;
}

/** A row to begin with: its weight is a usual one, and what it needs is as in the schema's examples. */
function begun({ properties, required = [] }, tag, kind) {
  const row = tag ? { [tag]: kind } : {};
  for (const [name, { const: fixed, default: usual, examples }] of Object.entries(properties)) {
    const isWanted = fixed === undefined && examples?.length && (name === "weight" || required.includes(name));
    if (isWanted && examples[0] !== usual) row[name] = examples[0];
  }
  return row;
}

function Row({ items, row, title, label, isNew, ...field }) {
  const { path, errors } = field;
  const box = useRef();
  const [isOpen, setOpen] = useState(isNew);
  const schema = formOf(items, row);
  const wrong = [...errorsAt(errors, path), ...errorsBelow(errors, path)];
  useEffect(() => {
    if (isNew) (box.current.querySelector("input, select") || box.current.querySelector("summary")).focus();
  }, []);
  const { first, numShown } = schema ? order(schema, items) : {};
  return html`<details ref=${box} open=${isOpen || wrong.length > 0} onToggle=${({ target }) => setOpen(target.open)}>
    <summary><code>${title}</code> <span class="facts">${brief(row, items.tag)}</span></summary>
    ${(isOpen || wrong.length > 0) && html`<div role="group" aria-label=${label}>
      ${schema
        ? html`<${Group} ...${shared(field)} ...${{ path, schema, first, numShown }} name=${title} isOpen />`
        : html`<${Wrong} errors=${wrong} />`}
    </div>`}
  </details>`;
}

/** What a term needs comes first, then its weight and its own fields; what all in the list have is folded. */
function order({ properties, required = [] }, { forms }) {
  const names = Object.keys(properties).filter((name) => properties[name].const === undefined);
  const needed = names.filter((name) => required.includes(name));
  if (forms.size === 1) return { first: needed };
  const isCommon = (name) => name !== "weight" && [...forms.values()].every((form) => name in form.properties);
  const first = [...new Set([...needed, ...names.filter((name) => name === "weight"), ...names.filter((name) => !isCommon(name))])];
  return { first, numShown: first.length };
}

/** What a row says, in a line. */
const brief = (row, tag) =>
  Object.entries(row)
    .filter(([name]) => name !== tag)
    .map(([name, value]) => `${words(name)} ${plain(value)}`)
    .join(" · ");

function plain(value) {
  if (value === null || typeof value !== "object") return String(value);
  if (!Array.isArray(value)) return Object.entries(value).map(([name, one]) => `${name} ${plain(one)}`).join(", ");
  return value.every((one) => typeof one === "number") ? JSON.stringify(value) : value.map((one) => one?.kind ?? plain(one)).join(", ");
}

/** A row a line. */
const written = (rows) => (rows.length ? `[\n${rows.map((row) => `  ${JSON.stringify(row)}`).join(",\n")}\n]` : "[]");

function AsText({ label, value, isDefault, change }) {
  const id = useId();
  const [typed, setTyped] = useState(null); // What was typed while it is being typed.
  const shown = typed ?? (typeof value === "string" ? value : isDefault && !value.length ? "" : Array.isArray(value) ? written(value) : JSON.stringify(value));
  let refusal = "";
  const read = (text) => {
    try {
      return parsed(text);
    } catch (error) {
      refusal = error.message;
      return text;
    }
  };
  if (shown.trim()) read(shown);
  const type = ({ target }) => {
    setTyped(target.value);
    change(target.value.trim() ? read(target.value) : undefined);
  };
  return html`<div class="field">
    <label for=${id}>${label}</label>
    <textarea id=${id} rows=${Math.min(16, Math.max(4, shown.split("\n").length))} spellcheck=${false} value=${shown} onInput=${type} onBlur=${() => setTyped(null)}
      aria-invalid=${refusal ? "true" : undefined} aria-describedby=${refusal ? `${id}-error` : undefined}></textarea>
    ${refusal && html`<p class="error" id="${id}-error">${refusal}</p>`}
  </div>`;
}

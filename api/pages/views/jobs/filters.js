/** Which jobs are shown: filters, search and labels, which stand in the address. */

import { html, useEffect, useRef, useState } from "../../lib/html.js";
import { change } from "../../lib/route.js";
import { WHOSE, WhoseFilters } from "../../parts/whose.js";

export const FILTERS = ["search", "status", "kind", "environment", "label", ...WHOSE];
const STATUSES = ["queued", "starting", "running", "cancelling", "succeeded", "failed", "cancelled"];
export function Filters({ asked }) {
  const [search, setSearch] = useState(asked.search[0] || "");
  const [refused, setRefused] = useState(null); // A label that is none.
  const timer = useRef();
  useEffect(() => () => clearTimeout(timer.current), []);
  const set = (parts, quietly) => change({ ...parts, cursor: [] }, quietly);
  const type = (event) => {
    const text = event.target.value;
    setSearch(text);
    clearTimeout(timer.current);
    timer.current = setTimeout(() => set({ search: text }, true), 250);
  };
  const addLabel = (event) => {
    event.preventDefault();
    const input = event.target.elements.label;
    const isLabel = /^[\w.-]+[:=]/.test(input.value);
    setRefused(isLabel || !input.value ? null : input.value);
    if (!isLabel) return;
    set({ label: [...asked.label, input.value.replace("=", ":")] });
    input.value = "";
  };
  return html`<search class="filters">
    <label>Search <input type="search" value=${search} onInput=${type} placeholder="name, note or environment" /></label>
    <label>Status
      <select value=${asked.status[0] || ""} onChange=${(event) => set({ status: event.target.value })}>
        <option value="">any</option>
        ${STATUSES.map((status) => html`<option value=${status}>${status}</option>`)}
      </select>
    </label>
    <label>Kind
      <select value=${asked.kind[0] || ""} onChange=${(event) => set({ kind: event.target.value })}>
        <option value="">any</option><option value="train">train</option><option value="rollout">rollout</option>
      </select>
    </label>
    <${WhoseFilters} asked=${asked} />
    <form onSubmit=${addLabel} novalidate>
      <label>Label <input name="label" placeholder="key:value" aria-invalid=${refused ? "true" : undefined} aria-describedby=${refused ? "label-error" : undefined} /></label>
    </form>
    ${["environment", "label"].flatMap((name) =>
      asked[name].map(
        (value) => html`<button type="button" class="label" aria-label="Remove the filter ${value}"
          onClick=${() => set({ [name]: asked[name].filter((other) => other !== value) })}>${value} ×</button>`,
      ),
    )}
    ${refused && html`<p class="error" id="label-error" role="alert">A label is a key and a value with a colon between them, such as <code>team:legs</code>; “${refused}” has no colon after a key.</p>`}
  </search>`;
}

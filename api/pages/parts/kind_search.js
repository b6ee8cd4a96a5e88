/** A search among kinds by name and by what they do: a combobox, whose list shows while it has the focus. */

import { html, useEffect, useId, useRef, useState } from "../lib/html.js";
import { Prose } from "./elements.js";

/** The first paragraph of what a form is. */
const told = ({ description = "" }) => description.split("\n\n")[0];

/** The kinds that have all the words, those first whose names have them. */
function found(forms, query) {
  const wanted = query.toLowerCase().replaceAll("_", " ").split(/\s+/).filter(Boolean);
  const hasAll = (text) => wanted.every((word) => text.toLowerCase().replaceAll("_", " ").includes(word));
  const kinds = [...forms.keys()].sort();
  const named = kinds.filter((kind) => hasAll(kind));
  return [...named, ...kinds.filter((kind) => !named.includes(kind) && hasAll(`${kind} ${told(forms.get(kind))}`))];
}

/** taken: the kinds that are there already; they may be taken again. choose: gets a kind. */
export function KindSearch({ label, forms, taken, choose }) {
  const id = useId();
  const list = useRef();
  const [query, setQuery] = useState("");
  const [isOpen, setOpen] = useState(false);
  const [active, setActive] = useState(0);
  const kinds = found(forms, query);
  const isListed = isOpen && kinds.length > 0;
  const take = (kind) => {
    choose(kind);
    setQuery("");
    setOpen(false);
  };
  const step = (by) => (setOpen(true), setActive((kinds.length + active + by) % kinds.length));
  const keys = {
    ArrowDown: () => (isOpen ? step(1) : setOpen(true)),
    ArrowUp: () => step(-1),
    Escape: () => setOpen(false),
    Enter: () => isListed && take(kinds[active]),
  };
  const press = (event) => {
    if (!keys[event.key]) return;
    event.preventDefault(); // Enter submits no form here.
    keys[event.key]();
  };
  useEffect(() => {
    if (isListed) list.current.children[active]?.scrollIntoView({ block: "nearest" });
  }, [active, isListed]);
  return html`<div class="field">
    <label for=${id}>${label}</label>
    <input id=${id} type="text" role="combobox" autocomplete="off" aria-autocomplete="list" aria-expanded=${isListed ? "true" : "false"} aria-controls="${id}-list"
      aria-activedescendant=${isListed ? `${id}-${kinds[active]}` : undefined} placeholder="search ${forms.size} kinds by name or by what they do" value=${query}
      onInput=${({ target }) => (setQuery(target.value), setActive(0), setOpen(true))} onClick=${() => setOpen(true)} onBlur=${() => setOpen(false)} onKeyDown=${press} />
    <ul id="${id}-list" class="kinds" role="listbox" aria-label="Kinds" ref=${list} hidden=${!isListed}>
      ${isListed && kinds.map(
        (kind, i) => html`<li key=${kind} id="${id}-${kind}" role="option" aria-selected=${i === active ? "true" : "false"}
          onMouseDown=${(event) => event.preventDefault()} onClick=${() => take(kind)}>
          <code>${kind}</code>${taken.includes(kind) && html` <span class="facts">(is in the list)</span>`} <span class="facts"><${Prose} text=${told(forms.get(kind))} /></span></li>`,
      )}
    </ul>
    ${isOpen && !kinds.length && html`<p class="facts" role="status">No kind is called so, or does so.</p>`}
  </div>`;
}

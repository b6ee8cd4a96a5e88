/** One's account: tokens; for admins users, projects, quotas and the audit log. */

import { html } from "../lib/html.js";
import { useCurrentInSight } from "../lib/in_sight.js";
import { href, useTitle } from "../lib/route.js";
import { isAdmin, session, signOut } from "../lib/session.js";
import { signedOut } from "../lib/api.js";
import { Empty } from "../parts/elements.js";
import { Audit } from "./account/audit.js";
import { Projects } from "./account/projects.js";
import { Quotas } from "./account/quotas.js";
import { Tokens } from "./account/tokens.js";
import { Users } from "./account/users.js";

const TABS = { tokens: ["Tokens", Tokens], users: ["Users", Users], projects: ["Projects", Projects], quotas: ["Quotas", Quotas], audit: ["Audit log", Audit] };

export default function Account({ path: [tab = "tokens"], query }) {
  const { accounts, who } = session();
  const tabs = useCurrentInSight(tab);
  const [name, Tab] = TABS[tab] || TABS.tokens;
  useTitle(name, "Account");
  if (!accounts) return html`<${Empty}><p>This service has no accounts: everybody who reaches it may do everything.</p><//>`;
  const leave = () => signOut().finally(signedOut);
  return html`
    <div class="title">
      <h1>${who.user}</h1>
      <button type="button" onClick=${leave}>Sign out</button>
    </div>
    <p class="facts message">${who.role}${who.projects.length ? ` in ${who.projects.join(", ")}` : ", in no project"}${
      who.scope === "admin" ? "" : ` · this session may only ${who.scope}`}</p>
    ${isAdmin() &&
    html`<nav class="tabs" aria-label="Parts of the account" ref=${tabs}>
      ${Object.entries(TABS).map(([key, [text]]) => html`<a key=${key} href=${href(["account", key])} aria-current=${key === tab ? "page" : undefined}>${text}</a>`)}
    </nav>`}
    <div class="stack"><${isAdmin() ? Tab : Tokens} query=${query} /></div>
  `;
}

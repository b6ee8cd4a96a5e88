/** Where the documentation is read: pyproject.toml names the repository. */

const DOCS = "https://github.com/gaitway/gaitway/blob/main/docs/";
const PAGES = {
  jobs: "training.md",
  compare: "page.md",
  sweeps: "sweeps.md",
  submit: "training.md",
  models: "environments/mjcf.md",
  workers: "operations.md",
};

/** The page of the documentation about a view. */
export const docsOf = (view) => `${DOCS}${PAGES[view] || "page.md"}`;

/** Models of users, as the service describes them. */

/** The body's name; the id's beginning where no worker has read the model. */
export const nameOf = ({ id, description }) => (description ? description.inventory.root : id.slice(0, 19));

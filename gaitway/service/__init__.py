"""All that starts, inspects or repairs a service. It is in the clone and the images, not in the wheel."""

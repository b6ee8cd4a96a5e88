"""The whole service on one machine: real servers, started and ended with their launcher."""

"""Messages and frames into the library's objects and back; nothing here decides anything."""

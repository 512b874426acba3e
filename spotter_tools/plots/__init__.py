"""Pictures for people: one message, or a recording. Needs the extra ``plot``; nothing here knows Zenoh or a clock."""

"""From descriptions to scenes: nested dicts, Mitsuba XML, geometry files."""

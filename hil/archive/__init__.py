"""A laboratory's archive: every unit's nights and campaigns through the years, and what they say of its life."""

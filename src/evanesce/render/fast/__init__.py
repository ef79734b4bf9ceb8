"""The fast renderer: fields computed once per rig, operators per contact state, one kernel from charge to pixels."""

"""The structured form: QPs in stages, solved at a cost that grows linearly with the horizon."""

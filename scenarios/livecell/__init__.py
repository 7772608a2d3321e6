"""An experiment without an end that is changed while it runs; who shows it is none of its business.

`Engine` runs one period after the other and takes commands between them; `Workshop` makes what they
ask for beside it; `Handover` passes the command from one controller to another without a jump.
"""

"""How well a set explains windows: its evidence in closed form, and the same of many sets at once.

Modules, each importing only from those before it:

    identities   columns that are readings of the output, and so no cause
    recent       what was last asked for, kept
    bank         window means of bases, computed once
    closed_form  the evidence of a set of forms in closed form
    screen       the evidence of many forms at once
    variants     the same of forms that differ in a basis or two
    pairs        the same of pairs of forms
"""

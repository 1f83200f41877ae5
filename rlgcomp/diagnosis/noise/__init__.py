"""What a set is weighed against: hypotheses of the noise, each by its parameters, with what errors of drivers add.

Modules, each importing only from those before it:

    errors      errors of drivers, which join the noise
    model       a noise by its parameters, and whitening by it
    hypotheses  the noises that are tried, with their prior
"""

"""What was found in equations, numbers, tables and pictures of functions, and as a simulator file.

Modules, each importing only from those before it:

    lines           frequency and width of a line that is not its mechanism's own
    time_laws       parameters of a law of time in its own equation
    stated          equations as they were found, and names of their numbers
    parameters      parameters of an equation, and whether it describes a term
    tabulated_laws  bases with their weights as tables of a simulator file
    simulator_file  the fitted model as a simulator: mechanisms, and tables where none expresses a term
    functions       members as tables over a driver, over time, as responses, as loops
    switches        where a sum of a few relays switches, and its steps
    equations       equations as LaTeX and expressions, and what their symbols mean
    findings        members with their parameters, their functions and their rivals
"""

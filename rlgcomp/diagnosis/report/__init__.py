"""What is told: the record of a diagnosis as text, pictures and a page.

Modules, each importing only from those before it:

    record    the data of a diagnosis; remarks, text, pictures and page read it
    remarks   headline, gain and remarks
    text      a diagnosis as text, and the cells of its tables
    pictures  pictures of a diagnosis
    page      the page of a diagnosis
    result    the diagnosis as scripts use it
"""

"""Every motion of a folder onto every character of another, by several processes, and to be resumed at any moment.

`plan` finds the files and names the results, `work` does one of them as a pure function of files and settings, `crew`
are the processes that do it, `manifest` remembers what is done, `lock` keeps two runs apart, `run` is the whole.
"""

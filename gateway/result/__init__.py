"""Result files and their exports: values of a result, certificates, controller formats, acceptance."""

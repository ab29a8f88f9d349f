"""Description of single frames and of whole captures for people; nothing found here is ever sent to a drive."""
